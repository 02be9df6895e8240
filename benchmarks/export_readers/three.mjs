// Reads exports with three.js (`npm install three gltf-validator`) and prints what it has then: node three.mjs MODULES FILE
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [modules, path] = process.argv.slice(2);
globalThis.self = globalThis;  // the loaders are written for browsers
globalThis.ProgressEvent ??= class {};
const at = name => import(pathToFileURL(`${modules}/node_modules/three/${name}`).href);
const THREE = await at("build/three.module.js");
const data = readFileSync(path);
const buffer = data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength);
const found = {};
let root;
if (path.endsWith(".glb")) {
  const { GLTFLoader } = await at("examples/jsm/loaders/GLTFLoader.js");
  root = (await new GLTFLoader().parseAsync(buffer, "")).scene;
  const validator = createRequire(`${modules}/`)("gltf-validator");
  const { issues } = await validator.validateBytes(new Uint8Array(data));
  found.validator = { errors: issues.numErrors, warnings: issues.numWarnings, version: validator.version() };
} else if (path.endsWith(".ply")) {
  const { PLYLoader } = await at("examples/jsm/loaders/PLYLoader.js");
  root = new THREE.Mesh(new PLYLoader().parse(buffer));
} else {
  const { OBJLoader } = await at("examples/jsm/loaders/OBJLoader.js");
  root = new OBJLoader().parse(data.toString());
}
root.updateMatrixWorld(true);
const rows = (attribute, read) => Array.from({ length: attribute.count }, (_, i) => read(new THREE.Vector3().fromBufferAttribute(attribute, i)));
root.traverse(thing => {
  if (!thing.isMesh) return;
  const { position, normal, color } = thing.geometry.attributes;
  found.points = rows(position, v => v.applyMatrix4(thing.matrixWorld).toArray());
  if (normal) found.normals = rows(normal, v => v.transformDirection(thing.matrixWorld).toArray());
  if (color) found.colours = rows(color, v => new THREE.Color(...v.toArray()).convertLinearToSRGB().toArray());
  const { metalness, roughness, vertexColors } = thing.material;
  found.material = { metalness, roughness, vertexColors };
});
console.log("\n" + JSON.stringify({ program: `three.js r${THREE.REVISION}`, ...found }));
