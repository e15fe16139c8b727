// Camera, panel, links and loading of the page. Part of SGS, licensed under MIT or Apache-2.0 (license.txt).
"use strict";

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const along = (a, by, b) => [a[0] + by * b[0], a[1] + by * b[1], a[2] + by * b[2]];
const unit = (a) => { const n = Math.hypot(...a) || 1; return a.map((v) => v / n); };

// Turns a vector about a unit axis (Rodrigues).
function turned(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle), w = cross(axis, v), along_axis = dot(axis, v) * (1 - c);
  return [0, 1, 2].map((k) => c * v[k] + s * w[k] + along_axis * axis[k]);
}

// The camera: `rotation` holds its axes in the world as rows: right, down, forward. `lens` is that of a photograph.
const camera = { position: [0, 0, 0], rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], view: 0 };
const state = { relit: false, stops: 0 };
let scene = null;

function step_to(view) {
  const n = scene.views.length;
  camera.view = ((view % n) + n) % n;
  const { rotation, position } = scene.views[camera.view];
  camera.rotation = rotation.map((row) => [...row]);
  camera.position = [...position];
  moved();
}

function moved() { viewer.wanted = viewer.dirty = true; show_view(); }

function show_view() {
  const { name } = scene.views[camera.view];
  $("view").textContent = `${camera.view + 1} / ${scene.views.length}  ${name}`;
}

// Turns to the right about the up direction, and down about the camera's right.
function look(right, down) {
  const yawed = camera.rotation.map((row) => turned(row, scene.up, -right));
  const pitched = yawed.map((row) => turned(row, yawed[0], -down));
  // No further than straight up or down.
  const steep = Math.abs(dot(pitched[2], scene.up)) > 0.998 && Math.abs(dot(pitched[2], scene.up)) > Math.abs(dot(yawed[2], scene.up));
  const [x, , z] = steep ? yawed : pitched, forward = unit(z), side = unit(along(x, -dot(x, forward), forward));
  camera.rotation = [side, cross(forward, side), forward];
  moved();
}

function move(right, up, forward) {
  camera.position = along(along(along(camera.position, right, camera.rotation[0]), up, scene.up), forward, camera.rotation[2]);
  moved();
}

// The camera in pixels of the canvas: the whole photograph's field of view fits.
function view_now() {
  const { size, focal, center, near } = scene.views[camera.view], canvas = $("canvas");
  const by = Math.min(canvas.width / size[0], canvas.height / size[1]);
  return {
    rotation: camera.rotation, position: camera.position, near,
    translation: camera.rotation.map((row) => -dot(row, camera.position)),
    focal: focal.map((f) => f * by),
    center: [canvas.width / 2 + (center[0] - size[0] / 2) * by, canvas.height / 2 + (center[1] - size[1] / 2) * by],
  };
}

// --- Panel ---

const hex_of = (color) => "#" + color.map((v) => Math.round(255 * encode_srgb(Math.max(0, Math.min(1, v)))).toString(16).padStart(2, "0")).join("");
const color_of_hex = (hex) => [1, 3, 5].map((k) => decode_srgb(parseInt(hex.slice(k, k + 2), 16) / 255));

function make_lights() {
  $("lights").hidden = scene.lights.length === 0;
  for (const light of scene.lights) {
    const row = document.createElement("div"), label = document.createElement("label");
    const [on, intensity, color] = ["checkbox", "range", "color"].map((type) => Object.assign(document.createElement("input"), { type }));
    Object.assign(intensity, { min: 0, max: 4, step: 0.05, title: "Intensity" });
    color.title = "Color";
    on.setAttribute("aria-label", `${light.name} on`);
    intensity.setAttribute("aria-label", `Intensity of ${light.name}`);
    color.setAttribute("aria-label", `Color of ${light.name}`);
    row.className = "row";
    label.append(on, ` ${light.name}`);
    label.title = light.name;
    row.append(label, intensity, color);
    $("list").append(row);
    light.show = () => { on.checked = light.on; intensity.value = light.intensity; color.value = hex_of(light.color); };
    const change = () => { state.relit = true; changed(); };
    on.onchange = () => { light.on = on.checked; change(); };
    intensity.oninput = () => { light.intensity = Number(intensity.value); light.on = light.on || light.intensity > 0; change(); };
    color.oninput = () => { light.color = color_of_hex(color.value); change(); };
  }
  reset_lights();
}

function reset_lights() {
  for (const light of scene.lights) Object.assign(light, { on: light.start.on, intensity: 1, color: [...light.start.color] });
}

let stale = false;

// After a change of lights or exposure: shows it in the panel and in the next frame.
function changed() {
  for (const light of scene.lights) light.show();
  $("relit").checked = state.relit;
  $("exposure").value = state.stops;
  $("stops").textContent = `${state.stops > 0 ? "+" : ""}${state.stops.toFixed(1)} stops`;
  stale = true;
}

function show_panel(shown) { $("panel").hidden = !shown; $("open").hidden = shown || !state.buttons; }

// --- Links: #view=3&lights=0,1,0.5&colors=ffffff,…&exposure=-1&pose=…&panel=0 ---

function write_link() {
  const parts = [`view=${camera.view}`];
  const own = scene.views[camera.view], numbers = [...camera.position, ...camera.rotation.flat()];
  const same = [...own.position, ...own.rotation.flat()].every((v, i) => Math.abs(v - numbers[i]) < 1e-9);
  if (!same) parts.push(`pose=${numbers.map((v) => Number(v.toPrecision(7))).join(",")}`);
  if (state.relit) {
    parts.push(`lights=${scene.lights.map((l) => (l.on ? l.intensity : 0)).join(",")}`);
    const colors = scene.lights.map((l) => hex_of(l.color));
    if (scene.lights.some((l, i) => hex_of(l.start.color) !== colors[i])) parts.push(`colors=${colors.map((c) => c.slice(1)).join(",")}`);
  }
  if (state.stops) parts.push(`exposure=${state.stops}`);
  location.hash = parts.join("&");
  if (navigator.clipboard) navigator.clipboard.writeText(location.href).catch(() => {});
}

// Values that are no numbers are ignored, so that a damaged link still shows the scene.
function read_link() {
  const link = new URLSearchParams(location.hash.slice(1)), list = (key) => (link.get(key) || "").split(",");
  const view = Number(link.get("view"));
  step_to(Number.isInteger(view) ? view : 0);
  const pose = list("pose").map(Number);
  if (pose.length === 12 && pose.every(Number.isFinite)) {
    const forward = unit(pose.slice(9)), x = pose.slice(3, 6), side = unit(along(x, -dot(x, forward), forward));
    camera.position = pose.slice(0, 3);
    camera.rotation = [side, cross(forward, side), forward];
  }
  reset_lights();
  state.relit = link.has("lights") && scene.lights.length > 0;
  if (state.relit) list("lights").forEach((text, i) => {
    const light = scene.lights[i], intensity = Number(text);
    if (light && text !== "" && intensity >= 0 && Number.isFinite(intensity)) Object.assign(light, { on: intensity > 0, intensity: intensity || 1 });
  });
  if (state.relit) list("colors").forEach((text, i) => {
    if (scene.lights[i] && /^[0-9a-f]{6}$/i.test(text)) scene.lights[i].color = color_of_hex(`#${text}`);
  });
  const stops = Number(link.get("exposure"));
  state.stops = Number.isFinite(stops) ? Math.max(-4, Math.min(4, stops)) : 0;
  state.buttons = link.get("panel") !== "0";
  show_panel(state.buttons);
  changed();
  moved();
}

// --- Mouse, touch and keys ---

const pressed = new Set(), fingers = new Map();

function listen() {
  const canvas = $("canvas");
  canvas.onpointerdown = (e) => { fingers.set(e.pointerId, [e.clientX, e.clientY]); canvas.setPointerCapture(e.pointerId); canvas.focus(); };
  canvas.onpointerup = canvas.onpointercancel = (e) => fingers.delete(e.pointerId);
  canvas.onpointermove = (e) => {
    const before = fingers.get(e.pointerId);
    if (!before) return;
    const [dx, dy] = [e.clientX - before[0], e.clientY - before[1]], high = canvas.clientHeight;
    if (fingers.size >= 2) {
      const [id] = [...fingers.keys()].filter((k) => k !== e.pointerId), other = fingers.get(id);
      const apart = (at) => Math.hypot(at[0] - other[0], at[1] - other[1]);
      const nearer = apart([e.clientX, e.clientY]) - apart(before);
      move(-scene.radius * dx / high / 2, scene.radius * dy / high / 2, 2 * scene.radius * nearer / high);
    } else if (e.buttons & 2 || e.buttons & 4) {
      move(-2 * scene.radius * dx / high, 2 * scene.radius * dy / high, 0);
    } else {
      const { focal } = view_now(), by = canvas.height / high;
      look(-dx * by / focal[0], -dy * by / focal[1]);
    }
    fingers.set(e.pointerId, [e.clientX, e.clientY]);
  };
  canvas.oncontextmenu = (e) => e.preventDefault();
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); move(0, 0, -scene.radius * e.deltaY * (e.deltaMode ? 0.02 : 0.0006)); }, { passive: false });
  addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey || e.target.matches("input") && e.code.startsWith("Arrow")) return;
    const once = { ArrowRight: () => step_to(camera.view + 1), ArrowLeft: () => step_to(camera.view - 1), Home: () => step_to(0), KeyP: () => show_panel($("panel").hidden) }[e.code];
    if (once) { e.preventDefault(); once(); } else pressed.add(e.code);
  });
  addEventListener("keyup", (e) => pressed.delete(e.code));
  addEventListener("blur", () => pressed.clear());
  addEventListener("hashchange", read_link);
  addEventListener("resize", () => { viewer.dirty = true; });
  $("before").onclick = () => step_to(camera.view - 1);
  $("next").onclick = () => step_to(camera.view + 1);
  $("close").onclick = () => { state.buttons = true; show_panel(false); };
  $("open").onclick = () => show_panel(true);
  $("link").onclick = write_link;
  $("relit").onchange = () => { state.relit = $("relit").checked; changed(); };
  $("reset").onclick = () => { reset_lights(); changed(); };
  $("exposure").oninput = () => { state.stops = Number($("exposure").value); changed(); };
}

// Moves by the keys that are down.
function fly(seconds) {
  const axis = (more, less) => Number(pressed.has(more)) - Number(pressed.has(less));
  const [right, up, forward] = [axis("KeyD", "KeyA"), axis("KeyE", "KeyQ"), axis("KeyW", "KeyS")];
  if (!right && !up && !forward) return;
  const fast = pressed.has("ShiftLeft") || pressed.has("ShiftRight") ? 4 : 1;
  const way = fast * 0.4 * scene.radius * Math.min(seconds, 0.1);
  move(way * right, way * up, way * forward);
}

// --- Frames and loading ---

let last = 0, mean = 0;

function frame(now) {
  if (failed) return;
  const seconds = (now - last) / 1000;
  last = now;
  fly(seconds);
  const by = Math.min(devicePixelRatio || 1, 2), canvas = $("canvas");
  viewer.resize(Math.max(1, Math.round(canvas.clientWidth * by)), Math.max(1, Math.round(canvas.clientHeight * by)));
  if (stale) {
    stale = false;
    viewer.dirty = true;
    if (state.relit) viewer.relight();
  }
  const view = view_now();
  viewer.order_for(view);
  const drew = viewer.dirty;
  if (drew) {
    viewer.draw(view, state.relit, 2 ** state.stops);
    // Time between frames that follow each other while something moves.
    if (seconds < 0.5) mean = mean ? 0.9 * mean + 0.1 * seconds : seconds;
    if (mean) $("frame").textContent = `${(1000 * mean).toFixed(1)} ms (${Math.round(1 / mean)} per second)`;
  }
  const done = viewer.loaded === scene.count && viewer.ordered === scene.count && !viewer.wanted && !viewer.sorting && !drew && !stale;
  document.documentElement.dataset.state = done ? "ready" : "working";
  requestAnimationFrame(frame);
}

// Called by scene.js.
function sgs_scene(description) {
  scene = description;
  for (const light of scene.lights) light.start = { on: light.on, color: light.color };
  viewer = new Viewer(scene);
  $("count").textContent = scene.count.toLocaleString("en");
  $("bytes").textContent = `${(scene.bytes / 1e6).toFixed(1)} MB`;
  make_lights();
  listen();
  read_link();
  requestAnimationFrame((now) => { last = now; frame(now); });
  load(0);
}

// Loads the files of the chunks one after another. Each is a script, because pages from files may not request data.
function load(chunk) {
  if (chunk * scene.chunk >= scene.count) { $("note").textContent = ""; return; }
  $("note").textContent = `Loading ${Math.round(100 * chunk * scene.chunk / scene.count)} %`;
  const script = document.createElement("script"), file = `data-${String(chunk).padStart(4, "0")}.js`;
  script.src = file;
  script.onload = () => { script.remove(); setTimeout(load, 0, chunk + 1); };
  script.onerror = () => fail(`The file ${file} beside this page is missing; copy the whole folder.`);
  document.body.append(script);
}

// Called by the files of the chunks.
function sgs_chunk(chunk, text) {
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; ++i) bytes[i] = letters.charCodeAt(i);
  viewer.add(chunk, bytes);
}
