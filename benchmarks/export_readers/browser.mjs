// Renders an export with three.js in Chromium, without light: node browser.mjs MODULES FILE CAMERA.json PICTURE.png
// A file with z up is turned to three.js's y up, as three.js advises; GLB is taken as it is.
import { execFileSync } from "node:child_process";
import { mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

const [modules, path, cameraFile, picture] = process.argv.slice(2);
const folder = mkdtempSync(join(tmpdir(), "three-"));
const three = pathToFileURL(`${modules}/node_modules/three/`).href;
const kind = path.split(".").pop();
const page = `<!doctype html><style>body{margin:0;background:#000}</style>
<script type="importmap">{"imports": {"three": "${three}build/three.module.js", "three/addons/": "${three}examples/jsm/"}}</script>
<script type="module">
import * as THREE from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { PLYLoader } from "three/addons/loaders/PLYLoader.js";
import { OBJLoader } from "three/addons/loaders/OBJLoader.js";
const view = ${readFileSync(cameraFile, "utf8")};
const data = Uint8Array.from(atob("${readFileSync(path).toString("base64")}"), c => c.charCodeAt(0)).buffer;
const kind = "${kind}";
const root = kind === "glb" ? (await new GLTFLoader().parseAsync(data, "")).scene
  : kind === "ply" ? new THREE.Mesh(new PLYLoader().parse(data))
  : new OBJLoader().parse(new TextDecoder().decode(data));
root.traverse(t => { if (t.isMesh) t.material = new THREE.MeshBasicMaterial({
  map: t.material.map ?? null, vertexColors: "color" in t.geometry.attributes, side: THREE.DoubleSide, toneMapped: false }); });
const scene = new THREE.Scene();
if (kind !== "glb") root.rotation.x = -Math.PI / 2;
scene.add(root);
const near = 0.01, far = 100, { width: w, height: h, fx, fy, cx, cy } = view;
const camera = new THREE.Camera();
camera.projectionMatrix.set(2 * fx / w, 0, 1 - 2 * (cx + 0.5) / w, 0, 0, 2 * fy / h, 2 * (cy + 0.5) / h - 1, 0,
  0, 0, -(far + near) / (far - near), -2 * far * near / (far - near), 0, 0, -1, 0);
camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
const pose = new THREE.Matrix4().set(...view.T_ec.flat()).multiply(new THREE.Matrix4().makeScale(1, -1, -1));
pose.premultiply(new THREE.Matrix4().makeRotationX(-Math.PI / 2));
pose.decompose(camera.position, camera.quaternion, camera.scale);
const renderer = new THREE.WebGLRenderer({ antialias: true });
renderer.setSize(w, h);
document.body.append(renderer.domElement);
renderer.render(scene, camera);
document.title = "r" + THREE.REVISION;
</script>`;
writeFileSync(join(folder, "page.html"), page);
const view = JSON.parse(readFileSync(cameraFile));
execFileSync("chromium", ["--headless=new", "--no-sandbox", "--hide-scrollbars", "--allow-file-access-from-files", "--use-angle=swiftshader",
  "--enable-unsafe-swiftshader", `--user-data-dir=${folder}/profile`, `--window-size=${view.width},${view.height}`,
  "--virtual-time-budget=30000", `--screenshot=${picture}`, pathToFileURL(join(folder, "page.html")).href], { stdio: "ignore", timeout: 300000 });
const { version } = JSON.parse(readFileSync(`${modules}/node_modules/three/package.json`));
console.log("\n" + JSON.stringify({ program: `three.js ${version} in Chromium` }));
