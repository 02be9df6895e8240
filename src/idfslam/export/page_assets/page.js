// The page of a scene: the mesh in three dimensions, the camera's path, and the keyframes. THREE is the bundle of three.min.js.
// The world has y up, in metres. A pose is [x, y, z, qx, qy, qz, qw] of a camera that looks along -z, as three.js has it.
"use strict";

const run = JSON.parse(document.getElementById("run").textContent);
const element = (id) => document.getElementById(id);
const UP = new THREE.Vector3(0, 1, 0);
const FLIGHT = 0.9; // [s] of a flight to another place. More: slower
const WALK = 1.4; // [m/s] of walking; with Shift three times as fast
const NEAR = 0.3; // [m] from the camera within which keyframes are not drawn: they would hide the view
const FIELD_OF_VIEW = 60; // [degrees] upwards, where no recorded camera has its own

// ---------------------------------------------------------------------------------------------------------------- the scene
const renderer = new THREE.WebGLRenderer({ canvas: element("view"), antialias: true, preserveDrawingBuffer: true });
renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
const scene = new THREE.Scene();
const camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW, 1, 0.02, 500);
scene.add(camera, new THREE.HemisphereLight(0xffffff, 0x8a8f96, 1.6));
const headlight = new THREE.DirectionalLight(0xffffff, 1.4);
headlight.position.set(0.3, 0.5, 1);
camera.add(headlight);
const ceiling = new THREE.Plane(new THREE.Vector3(0, -1, 0), Infinity); // hides what lies higher
const orbit = new THREE.OrbitControls(camera, renderer.domElement);
orbit.enableDamping = true;
const room = { low: new THREE.Vector3(...run.low), high: new THREE.Vector3(...run.high) };
const centre = room.low.clone().add(room.high).multiplyScalar(0.5);
const size = room.low.distanceTo(room.high);

const materials = {}; // one for each look, without backs: so walls and ceiling are seen through from outside
let surface = null;

// The texture has no mip levels, which would mix patches. At a triangle's border the place in the texture is that of the covered part of a pixel: beside it lies another triangle's patch.
function sampledInside(shader) {
  for (const stage of ["vertex", "fragment"]) {
    const include = `uv_pars_${stage}`, chunk = THREE.ShaderChunk[include].replace("varying vec2 vMapUv", "centroid varying vec2 vMapUv");
    shader[`${stage}Shader`] = shader[`${stage}Shader`].replace(`#include <${include}>`, chunk);
  }
}

async function loadMesh() {
  const bytes = Uint8Array.from(atob(element("mesh").textContent), (c) => c.charCodeAt(0)).buffer;
  const model = (await new THREE.GLTFLoader().parseAsync(bytes, "")).scene;
  model.traverse((part) => { if (part.isMesh) surface = part; });
  const shared = { side: THREE.FrontSide, clippingPlanes: [ceiling] };
  const map = surface.material.map;
  const vertexColors = !map && "color" in surface.geometry.attributes;
  materials.colours = new THREE.MeshBasicMaterial({ ...shared, map, vertexColors, toneMapped: false });
  if (map) materials.colours.onBeforeCompile = sampledInside;
  materials.shape = new THREE.MeshLambertMaterial({ ...shared, color: 0xd8d4cc });
  scene.add(model);
}

// ---------------------------------------------------------------------------------------------------------------- the path
const place = (pose) => new THREE.Vector3(pose[0], pose[1], pose[2]);
const turn = (pose) => new THREE.Quaternion(pose[3], pose[4], pose[5], pose[6]);
const path = new THREE.Group();
const marks = new THREE.Group();

function drawPath() {
  const line = new THREE.LineGeometry();
  line.setPositions(run.path.flatMap((pose) => pose.slice(0, 3)));
  line.setColors(run.path.flatMap((_, i) => new THREE.Color(run.statuses[run.status[i]].colour).toArray()));
  path.add(new THREE.Line2(line, new THREE.LineMaterial({ linewidth: 3, vertexColors: true, toneMapped: false }))); // [px] wide
  scene.add(path);
}

// A keyframe is drawn as the pyramid of its camera; its base takes clicks.
function drawKeyframes() {
  const deep = Math.min(0.2, Math.max(0.04, size * 0.02));
  const { width, height, fx, fy, cx, cy } = run.camera;
  const x = [-(cx + 0.5) / fx, (width - cx - 0.5) / fx], y = [(cy + 0.5) / fy, -(height - cy - 0.5) / fy];
  const corners = [[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]].map(([a, b]) => [a * deep, b * deep, -deep]);
  const edges = corners.flatMap((corner, i) => [...corner, ...corners[(i + 1) % 4], 0, 0, 0, ...corner]);
  const outline = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(new Float32Array(edges), 3));
  const base = new THREE.BufferGeometry();
  base.setAttribute("position", new THREE.BufferAttribute(new Float32Array(corners.flat()), 3));
  base.setAttribute("uv", new THREE.BufferAttribute(new Float32Array([0, 1, 1, 1, 1, 0, 0, 0]), 2));
  base.setIndex([0, 3, 1, 1, 3, 2]);
  const ink = new THREE.LineBasicMaterial({ color: 0xe8622c, toneMapped: false });
  run.keyframes.forEach((keyframe, i) => {
    const mark = new THREE.Group();
    mark.position.copy(place(keyframe.pose));
    mark.quaternion.copy(turn(keyframe.pose));
    const glass = new THREE.MeshBasicMaterial({ color: 0xe8622c, transparent: true, opacity: 0.18, side: THREE.DoubleSide, depthWrite: false, toneMapped: false });
    const pane = new THREE.Mesh(base, glass);
    pane.userData.keyframe = i;
    mark.add(new THREE.LineSegments(outline, ink), pane);
    marks.add(mark);
  });
  scene.add(marks);
}

// ---------------------------------------------------------------------------------------------------------------- moving about
let mode = "orbit"; // or "walk", "play"
let flight = null; // towards another place
let selected = -1; // keyframe
let at = 0; // place on the path while it is played, in frames
const look = { yaw: 0, pitch: 0 };
const pressed = new Set();

function setMode(next) {
  mode = next;
  orbit.enabled = mode === "orbit";
  element("walk").setAttribute("aria-pressed", mode === "walk");
  element("play").setAttribute("aria-pressed", mode === "play");
  element("play").textContent = mode === "play" ? "❚❚ Pause" : "▶ Along the path";
  element("hint").textContent = HINTS[mode];
}
const HINTS = {
  orbit: "Drag to turn, right drag or two fingers to move, wheel or pinch to come nearer. Click a keyframe to fly there.",
  walk: "Drag to look around, W A S D or arrow keys to walk, Q and E to sink and rise, Shift to run. Double click or tap a place to go there.",
  play: "The camera follows its recorded path. Drag the slider below to choose a frame.",
};

function flyTo(position, quaternion, fov, then) {
  const from = { position: camera.position.clone(), quaternion: camera.quaternion.clone(), fov: camera.fov };
  flight = { from, position, quaternion, fov, then, begun: performance.now() };
}

function arrive(pose) {
  camera.position.copy(pose.position);
  camera.quaternion.copy(pose.quaternion);
  camera.fov = pose.fov;
  camera.updateProjectionMatrix();
}

function stepFlight(now) {
  const share = Math.min(1, (now - flight.begun) / 1000 / FLIGHT), eased = share * share * (3 - 2 * share);
  arrive({
    position: flight.from.position.clone().lerp(flight.position, eased),
    quaternion: flight.from.quaternion.clone().slerp(flight.quaternion, eased),
    fov: flight.from.fov + (flight.fov - flight.from.fov) * eased,
  });
  if (share < 1) return;
  const { then } = flight;
  flight = null;
  then?.();
}

// Outside, with all of the room in view, from a direction (x, y, z).
function lookFrom(direction) {
  const to = new THREE.Vector3(...direction).normalize();
  const half = (FIELD_OF_VIEW / 2) * Math.PI / 180, narrow = Math.min(half, Math.atan(Math.tan(half) * camera.aspect));
  const right = Math.abs(to.y) > 0.999 ? new THREE.Vector3(1, 0, 0) : new THREE.Vector3().crossVectors(UP, to).normalize();
  const above = new THREE.Vector3().crossVectors(to, right);
  const free = Math.max(0.4, 1 - 2 * element("tools").offsetHeight / innerHeight); // share of the window that nothing covers
  let distance = 0.5;
  for (let i = 0; i < 8; i++) {
    const corner = new THREE.Vector3(i & 1 ? room.high.x : room.low.x, i & 2 ? room.high.y : room.low.y, i & 4 ? room.high.z : room.low.z).sub(centre);
    const beside = Math.abs(corner.dot(right)) / Math.tan(Math.atan(Math.tan(half) * camera.aspect)), over = Math.abs(corner.dot(above)) / (Math.tan(half) * free);
    distance = Math.max(distance, corner.dot(to) + 1.05 * Math.max(beside, over));
  }
  const position = centre.clone().addScaledVector(to, distance);
  const quaternion = new THREE.Quaternion().setFromRotationMatrix(new THREE.Matrix4().makeBasis(right, above, to));
  orbit.target.copy(centre);
  orbit.maxDistance = Math.max(4 * size, 2 * distance);
  setMode("orbit");
  orbit.enabled = false;
  return { position, quaternion, fov: FIELD_OF_VIEW, then: () => setMode("orbit") };
}

const recordedFov = () => 2 * Math.atan(run.camera.height / 2 / run.camera.fy) * 180 / Math.PI;

function startWalking() {
  const ahead = camera.getWorldDirection(new THREE.Vector3());
  look.yaw = Math.atan2(-ahead.x, -ahead.z);
  look.pitch = Math.asin(Math.max(-1, Math.min(1, ahead.y)));
  setMode("walk");
}

function stepWalk(seconds) {
  const pace = WALK * seconds * (pressed.has("shift") ? 3 : 1);
  const axis = (more, less) => (more.some((key) => pressed.has(key)) ? 1 : 0) - (less.some((key) => pressed.has(key)) ? 1 : 0);
  const forward = axis(["w", "arrowup"], ["s", "arrowdown"]), aside = axis(["d", "arrowright"], ["a", "arrowleft"]), rise = axis(["e"], ["q"]);
  if (!forward && !aside && !rise) return;
  const ahead = new THREE.Vector3(-Math.sin(look.yaw), 0, -Math.cos(look.yaw)), right = new THREE.Vector3(-ahead.z, 0, ahead.x);
  camera.position.addScaledVector(ahead, forward * pace).addScaledVector(right, aside * pace).addScaledVector(UP, rise * pace);
  turnHead(0, 0);
}

function turnHead(yaw, pitch) {
  look.yaw += yaw;
  look.pitch = Math.max(-1.5, Math.min(1.5, look.pitch + pitch));
  const level = new THREE.Quaternion().setFromAxisAngle(UP, look.yaw);
  camera.quaternion.copy(level.multiply(new THREE.Quaternion().setFromAxisAngle(new THREE.Vector3(1, 0, 0), look.pitch)));
}

// ---------------------------------------------------------------------------------------------------------------- the path from inside
function showFrame(frame) {
  at = Math.max(0, Math.min(run.path.length - 1, frame));
  const before = run.path[Math.floor(at)], after = run.path[Math.ceil(at)], share = at - Math.floor(at);
  arrive({ position: place(before).lerp(place(after), share), quaternion: turn(before).slerp(turn(after), share), fov: recordedFov() });
  element("time").value = at;
  tellFrame();
}

function tellFrame() {
  const i = Math.round(at), status = run.statuses[run.status[i]];
  element("frame").textContent = `frame ${run.frames[i]}, ${status.name}`;
}

// ---------------------------------------------------------------------------------------------------------------- keyframes
function select(i) {
  selected = i;
  const keyframe = run.keyframes[i];
  element("card").hidden = i < 0;
  if (i < 0) return;
  element("caption").textContent = `Keyframe ${i + 1} of ${run.keyframes.length}, frame ${keyframe.frame}`;
  element("picture").hidden = !keyframe.picture;
  if (keyframe.picture) element("picture").src = keyframe.picture;
  else element("caption").textContent += " (its picture is not in this file)";
}

function goToKeyframe(i) {
  select((i + run.keyframes.length) % run.keyframes.length);
  const { pose } = run.keyframes[selected];
  setMode("walk");
  return { position: place(pose), quaternion: turn(pose), fov: recordedFov(), then: startWalking };
}

const ray = new THREE.Raycaster();
function underPointer(event, objects) {
  const box = renderer.domElement.getBoundingClientRect();
  ray.setFromCamera(new THREE.Vector2(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2), camera);
  return ray.intersectObjects(objects, true).find((hit) => hit.object.isMesh && hit.object.visible && hit.object.parent.visible && hit.point.y < ceiling.constant);
}

// ---------------------------------------------------------------------------------------------------------------- what the user does
function fly(target) { flyTo(target.position, target.quaternion, target.fov, target.then); }
element("overview").onclick = () => { select(-1); fly(lookFrom(run.side)); };
element("above").onclick = () => { select(-1); fly(lookFrom([0, 1, 0.0001])); };
element("walk").onclick = () => {
  const nearest = run.path.reduce((best, pose, i) => (place(pose).distanceTo(camera.position) < place(run.path[best]).distanceTo(camera.position) ? i : best), 0);
  const outside = mode === "orbit";
  select(-1);
  setMode("walk");
  if (outside) fly({ position: place(run.path[nearest]), quaternion: turn(run.path[nearest]), fov: FIELD_OF_VIEW, then: startWalking });
  else startWalking();
};
element("play").onclick = () => {
  select(-1);
  if (mode === "play") { startWalking(); return; }
  if (at >= run.path.length - 1) at = 0;
  setMode("play");
};
element("time").oninput = () => { select(-1); flight = null; setMode("walk"); showFrame(Number(element("time").value)); startWalking(); };
const setLook = (name) => {
  surface.material = materials[name];
  for (const one of ["colours", "shape"]) element(one).setAttribute("aria-pressed", one === name);
};
element("colours").onclick = () => setLook("colours");
element("shape").onclick = () => setLook("shape");
element("showKeyframes").onchange = () => { marks.visible = element("showKeyframes").checked; };
const setCeiling = () => {
  const share = Number(element("height").value);
  ceiling.constant = share >= 1 ? 1e9 : room.low.y + share * (room.high.y - room.low.y);
};
element("height").oninput = setCeiling;
element("previous").onclick = () => fly(goToKeyframe(selected - 1));
element("next").onclick = () => fly(goToKeyframe(selected + 1));
element("close").onclick = () => select(-1);

let drag = null; // where the pointer went down, and how far it went
renderer.domElement.addEventListener("pointerdown", (event) => {
  drag = { x: event.clientX, y: event.clientY, far: 0 };
  if (mode === "play") startWalking();
});
addEventListener("pointermove", (event) => {
  if (!drag) {
    renderer.domElement.style.cursor = event.target === renderer.domElement && marks.visible && underPointer(event, [marks]) ? "pointer" : "";
    return;
  }
  const dx = event.clientX - drag.x, dy = event.clientY - drag.y;
  drag = { x: event.clientX, y: event.clientY, far: drag.far + Math.abs(dx) + Math.abs(dy) };
  if (mode === "walk" && !flight) turnHead(dx * 0.004, dy * 0.004);
});
addEventListener("pointerup", (event) => {
  const clicked = drag && drag.far < 6 && event.target === renderer.domElement && marks.visible ? underPointer(event, [marks]) : null;
  drag = null;
  if (clicked) fly(goToKeyframe(clicked.object.userData.keyframe));
});
addEventListener("pointercancel", () => { drag = null; });
renderer.domElement.addEventListener("dblclick", (event) => {
  const hit = mode === "walk" && !flight && surface ? underPointer(event, [surface]) : null;
  if (!hit) return;
  const to = hit.point.clone().lerp(camera.position, Math.min(1, 0.6 / hit.distance)); // stops short of it, at the same height
  to.y = camera.position.y;
  fly({ position: to, quaternion: camera.quaternion.clone(), fov: camera.fov });
});
renderer.domElement.addEventListener("wheel", (event) => {
  if (mode !== "walk") return;
  event.preventDefault();
  camera.position.addScaledVector(camera.getWorldDirection(new THREE.Vector3()), -Math.sign(event.deltaY) * 0.15);
}, { passive: false });
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const key = event.key.toLowerCase();
  const moves = ["w", "a", "s", "d", "q", "e", "shift", "arrowup", "arrowdown", "arrowleft", "arrowright"].includes(key);
  if (!moves || event.target.tagName === "INPUT") return;
  event.preventDefault();
  pressed.add(key);
  if (mode === "play" && key !== "shift") startWalking();
});
addEventListener("keyup", (event) => pressed.delete(event.key.toLowerCase()));
addEventListener("blur", () => pressed.clear());

// ---------------------------------------------------------------------------------------------------------------- each picture
function resize() {
  const { clientWidth: width, clientHeight: height } = renderer.domElement;
  const ratio = renderer.getPixelRatio();
  if (renderer.domElement.width === Math.floor(width * ratio) && renderer.domElement.height === Math.floor(height * ratio)) return;
  renderer.setSize(width, height, false);
  camera.aspect = width / height;
  camera.updateProjectionMatrix();
}

let last = performance.now();
function draw(now) {
  const seconds = Math.min(0.1, (now - last) / 1000);
  last = now;
  resize();
  if (flight) stepFlight(now);
  else if (mode === "orbit") orbit.update();
  else if (mode === "walk") stepWalk(seconds);
  else {
    showFrame(at + seconds * run.perSecond);
    if (at >= run.path.length - 1) startWalking();
  }
  path.visible = element("showPath").checked && mode !== "play";
  marks.children.forEach((mark, i) => { mark.visible = i !== selected && mark.position.distanceTo(camera.position) > NEAR; });
  renderer.render(scene, camera);
  requestAnimationFrame(draw);
}

// The address says what is shown first: scene.html#view=above&look=shape, #frame=120, #keyframe=3.
function begin() {
  const wanted = new URLSearchParams(location.hash.slice(1));
  resize();
  setLook(wanted.get("look") === "shape" ? "shape" : "colours");
  const target = wanted.has("keyframe") && run.keyframes.length ? goToKeyframe(Number(wanted.get("keyframe")) || 0)
    : wanted.get("view") === "above" ? lookFrom([0, 1, 0.0001]) : lookFrom(run.side);
  arrive(target);
  target.then();
  if (wanted.has("frame")) { setMode("walk"); showFrame(Number(wanted.get("frame")) || 0); startWalking(); } else tellFrame();
}

async function main() {
  element("time").max = run.path.length - 1;
  const used = [...new Set(run.status)].sort();
  element("legend").replaceChildren(...used.map((k) => {
    const entry = document.createElement("span"), dot = document.createElement("i");
    dot.style.background = run.statuses[k].colour;
    entry.append(dot, run.statuses[k].name);
    entry.title = run.statuses[k].meaning;
    return entry;
  }));
  renderer.localClippingEnabled = true;
  scene.background = new THREE.Color(getComputedStyle(document.body).backgroundColor);
  setCeiling();
  drawPath();
  drawKeyframes();
  await loadMesh();
  begin();
  renderer.render(scene, camera);
  element("loading").remove();
  document.body.dataset.shown = "yes";
  requestAnimationFrame(draw);
}
main().catch((error) => { element("loading").textContent = `The scene cannot be shown: ${error.message}`; });
