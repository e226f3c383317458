"use strict";
// Controls of the page. Its state is a part of its address, after #: mm (intensity), t (a pause at a time), split (place of the
// divider, 0: none), camera=x,y,z,w,x,y,z,fov (a free one), view (a named view, or none: the path); `size=WxH` fixes the size, `still=1` waits for a script.

const duration = settings.pathStep * (settings.path.length - 1), LAST_STEP = settings.states.length - 1;
const state = {time: 0, step: settings.chosen, split: 0.5, playing: false, free: null, view: null, size: null};
const keys = new Set(), SLIDER_KEYS = /^(Arrow|Home|End|Page)/;
const SLOW_MS = 60, COARSEST = 0.5;  // of a picture while it moves; share of the screen's pixels along a side

// One exact picture: a view as in the address, as a data URL; for tests and figures.
async function image(options = {}) {
  Object.assign(state, viewOf(options), {playing: false});
  fit();
  const camera = withSize(state.free ?? pathCamera(state.time), canvas.width, canvas.height);
  draw(camera, await answer(camera, state.time, state.step), state.split ?? 0);
  show();
  return canvas.toDataURL("image/png");
}

// Views and their text

function viewOf({mm, t, split, camera, size}) {
  const view = {};
  if (mm !== undefined) {
    const distances = settings.states.map(each => Math.abs(each.intensity - mm));
    view.step = distances.indexOf(Math.min(...distances));
  }
  if (t !== undefined) view.time = Math.max(0, Number(t) || 0);
  if (split !== undefined) view.split = Number(split) > 0 ? Math.min(Number(split), 1) : null;
  if (size !== undefined) view.size = String(size).split("x").map(Number);
  const numbers = String(camera).split(",").map(Number);
  if (numbers.length === 8 && numbers.every(Number.isFinite))
    view.free = {position: numbers.slice(0, 3), axes: transposed(rotationOf(numbers.slice(3, 7))), fov: numbers[7], velocity: [0, 0, 0], floor: settings.floors[0]};
  return view;
}

// A named view by its number: its camera, and its time and intensity if it has them.
function named(number) {
  const {camera, t, mm, floor} = settings.views[number], view = viewOf({camera, t, mm});
  return {...view, free: {...view.free, floor}, view: number};
}

function textOf({time, step, split, free, playing}) {
  const parts = [`mm=${settings.states[step].intensity}`, `split=${(split ?? 0).toFixed(2)}`];
  if (!playing) parts.push(`t=${time.toFixed(2)}`);
  if (!free && settings.view !== null) parts.push("view=");
  if (free) parts.push(`camera=${[...free.position, ...quaternionOf(free.axes), free.fov].map(each => Number(each.toFixed(4))).join(",")}`);
  return `#${parts.join("&")}`;
}

// Camera to world (w x y z) of a camera that has right, down and forward as rows of its axes.
function quaternionOf(axes) {
  const [a, b, c] = transposed(axes), trace = a[0] + b[1] + c[2];
  const rows = [[1 + trace, c[1] - b[2], a[2] - c[0], b[0] - a[1]], [c[1] - b[2], 1 + a[0] - b[1] - c[2], a[1] + b[0], a[2] + c[0]],
                [a[2] - c[0], a[1] + b[0], 1 - a[0] + b[1] - c[2], b[2] + c[1]], [b[0] - a[1], a[2] + c[0], b[2] + c[1], 1 - a[0] - b[1] + c[2]]];
  const largest = rows.reduce((best, row, k) => row[k] > best[0] ? [row[k], row] : best, [-1, null])[1];
  return largest.map(each => each / Math.hypot(...largest));
}

let remembering = 0;
function remember() {  // the view in the address, once it rests
  clearTimeout(remembering);
  remembering = setTimeout(() => { try { history.replaceState(null, "", textOf(state)); } catch { /* a browser may forbid it on a disk */ } }, 300);
}

function follow() {  // the address; without a time it plays
  const asked = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
  const moves = duration > 0 || settings.states.some(each => each.density > 0);
  const playing = asked.t === undefined && moves && !matchMedia("(prefers-reduced-motion: reduce)").matches;
  Object.assign(state, {free: null, view: null}, viewOf(asked), {playing});
  const byName = settings.views.findIndex(view => view.name === asked.view);
  const number = asked.view === undefined && !state.free && asked.t === undefined ? settings.view : byName;
  if (number !== null && number >= 0) {  // a page opens with its own intensity
    const {step = state.step, ...view} = named(number), keeps = asked.view === undefined || asked.mm !== undefined;
    Object.assign(state, view, keeps ? {} : {step});
  }
  show();
}

// Display

let pixels = 1;  // share of the screen's pixels along a side, fewer while a slow graphics card moves the picture
function fit() {  // the canvas to the window, or to the size that was asked for
  const ratio = Math.min(window.devicePixelRatio || 1, 2) * pixels;
  const [width, height] = state.size ?? [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, {width, height});
}

const clock = seconds => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;

function show() {
  const rain = settings.states[state.step], named = rain.class ? `, ${rain.class}` : "", words = rain.intensity ? `${rain.intensity} mm/h${named}` : "dry";
  element("intensity-name").textContent = words;
  element("intensity").value = state.step;
  element("intensity").setAttribute("aria-valuetext", words);
  element("time").value = duration ? 1000 * state.time / duration : 0;
  element("clock").textContent = `${clock(state.time)} / ${clock(duration)}`;
  element("play").setAttribute("aria-pressed", state.playing);
  element("compare").setAttribute("aria-pressed", state.split !== null);
  element("home").hidden = !state.free;
  if (settings.views.length) element("views").value = state.view ?? "";
  const divider = element("divider");
  divider.hidden = state.split === null;
  divider.style.left = `${100 * (state.split ?? 0)}%`;
  divider.setAttribute("aria-valuenow", Math.round(100 * (state.split ?? 0)));
  divider.lastElementChild.textContent = rain.intensity ? `${rain.intensity} mm/h` : "dry";
}

let telling = 0;
function announce(words) {
  element("toast").textContent = words;
  clearTimeout(telling);
  telling = setTimeout(() => { element("toast").textContent = ""; }, 2500);
}

let hasFailed = false;
function failed(error) {
  hasFailed = true;
  element("notice").hidden = false;
  element("loaded").hidden = true;
  element("doing").textContent = `This scene can't be shown: ${error.message}.`;
}

// Actions

const actions = {
  play() { state.playing = !state.playing; },
  home() { Object.assign(state, {free: null, view: null}); },
  compare() { state.split = state.split === null ? 0.5 : null; },
  more() { state.step = Math.min(state.step + 1, LAST_STEP); },
  less() { state.step = Math.max(state.step - 1, 0); },
  about() { element("about").showModal(); },
  full() { document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen?.(); },
  link() {
    const link = location.href.split("#")[0] + textOf(state), isInAddress = () => announce("The address of this page is a link to this view");
    if (!navigator.clipboard) isInAddress();
    else navigator.clipboard.writeText(link).then(() => announce("Link to this view copied"), isInAddress);
  },
};
const ACTION_OF_KEY = {" ": "play", home: "home", c: "compare", f: "full", l: "link", i: "about", "?": "about", "+": "more", "=": "more", "-": "less"};

function act(name) {
  actions[name]();
  show();
  remember();
}

function freed() {
  state.free ??= {...pathCamera(state.time), velocity: [0, 0, 0]};
  if (state.view !== null) { state.view = null; show(); }
  remember();
  return state.free;
}

function goTo(number) {
  Object.assign(state, named(number));
  show();
  remember();
}

function look(dx, dy) {
  const camera = freed(), radians = camera.fov / canvas.clientHeight * Math.PI / 180, forward = camera.axes[2];
  const heading = Math.atan2(forward[1], forward[0]) + dx * radians;
  const rise = Math.min(Math.max(Math.asin(Math.max(-1, Math.min(1, forward[2]))) + dy * radians, -1.5), 1.5);
  const ahead = [Math.cos(heading) * Math.cos(rise), Math.sin(heading) * Math.cos(rise), Math.sin(rise)];
  const right = [Math.sin(heading), -Math.cos(heading), 0];
  const down = [0, 1, 2].map(k => ahead[(k + 1) % 3] * right[(k + 2) % 3] - ahead[(k + 2) % 3] * right[(k + 1) % 3]);
  camera.axes = [right, down, ahead];
}

function shift(right, down, ahead) {  // meters
  const camera = freed(), moved = times(transposed(camera.axes), [right, down, ahead]);
  camera.position = camera.position.map((each, k) => each + moved[k]);
}

function move(seconds) {
  const along = {KeyW: [0, 0, 1], ArrowUp: [0, 0, 1], KeyS: [0, 0, -1], ArrowDown: [0, 0, -1], KeyA: [-1, 0, 0], ArrowLeft: [-1, 0, 0],
                 KeyD: [1, 0, 0], ArrowRight: [1, 0, 0], KeyE: [0, -1, 0], KeyQ: [0, 1, 0]};
  const sum = [...keys].reduce((total, key) => total.map((each, k) => each + (along[key]?.[k] ?? 0)), [0, 0, 0]);
  if (!sum.some(Boolean)) { if (state.free) state.free.velocity = [0, 0, 0]; return; }
  const camera = freed(), speed = keys.has("ShiftLeft") || keys.has("ShiftRight") ? 20 : 5;
  camera.velocity = times(transposed(camera.axes), sum).map(each => each * speed);
  camera.position = camera.position.map((each, k) => each + camera.velocity[k] * seconds);
}

// Pointers: one turns the view; the middle one of a mouse, or two fingers, shift it, and fingers that part move ahead.
function wirePointers() {
  const fingers = new Map(), METERS = 0.01;  // for each pixel
  const middle = () => [...fingers.values()].reduce((sum, each) => [sum[0] + each.x / fingers.size, sum[1] + each.y / fingers.size], [0, 0]);
  const spread = () => { const [a, b] = [...fingers.values()]; return b ? Math.hypot(a.x - b.x, a.y - b.y) : 0; };
  canvas.addEventListener("pointerdown", event => {
    fingers.set(event.pointerId, {x: event.clientX, y: event.clientY});
    canvas.setPointerCapture(event.pointerId);
    canvas.focus();
    if (event.button === 1) event.preventDefault();
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, event => fingers.delete(event.pointerId));
  canvas.addEventListener("pointermove", event => {
    if (!fingers.has(event.pointerId)) return;
    const [x, y] = middle(), apart = spread();
    fingers.set(event.pointerId, {x: event.clientX, y: event.clientY});
    const [toX, toY] = middle(), [dx, dy] = [toX - x, toY - y];
    if (fingers.size === 1 && !event.shiftKey && event.buttons !== 4) look(dx, dy);
    else shift(-METERS * dx, -METERS * dy, 2 * METERS * (spread() - apart));
  });
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    shift(0, 0, -METERS * event.deltaY * (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 33 : 1));
  }, {passive: false});
  const divider = element("divider"), slide = x => { state.split = Math.min(Math.max(x, 0.02), 0.98); show(); remember(); };
  divider.onpointerdown = event => divider.setPointerCapture(event.pointerId);
  divider.onpointermove = event => { if (divider.hasPointerCapture(event.pointerId)) slide(event.clientX / innerWidth); };
  divider.onkeydown = event => {
    const step = {ArrowLeft: -0.02, ArrowRight: 0.02, PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1}[event.code];
    if (step) { slide(state.split + step); event.preventDefault(); }
  };
}

function wire() {
  wirePointers();
  addEventListener("keydown", event => {
    if (event.target instanceof HTMLSelectElement) return;
    const isSlider = event.target instanceof HTMLInputElement || event.target === element("divider");
    if (element("about").open || event.ctrlKey || event.metaKey || event.altKey || (isSlider && SLIDER_KEYS.test(event.code))) return;
    if (event.target instanceof HTMLButtonElement && event.code === "Space") return;  // presses it
    if (/^[1-9]$/.test(event.key) && settings.views[event.key - 1]) { goTo(event.key - 1); return; }
    const action = ACTION_OF_KEY[event.key.toLowerCase()];
    if (!action) keys.add(event.code);
    else if (!event.repeat || action === "more" || action === "less") act(action);
    if (action || event.code.startsWith("Arrow")) event.preventDefault();
  });
  addEventListener("keyup", event => keys.delete(event.code));
  addEventListener("blur", () => keys.clear());
  addEventListener("hashchange", follow);
  for (const button of document.querySelectorAll("button[data-action]"))
    button.onclick = event => { act(button.dataset.action); if (event.detail) canvas.focus(); };  // so that keys move after a click
  element("full").hidden = !document.fullscreenEnabled;
  const ticks = element("ticks");
  settings.states.forEach(({intensity}, k) => {
    if (k % 2 && k < LAST_STEP) return;
    const tick = ticks.appendChild(document.createElement("span"));
    tick.textContent = intensity || "dry";
    tick.style.setProperty("--place", k / LAST_STEP);
  });
  Object.assign(element("intensity"), {max: LAST_STEP, oninput: event => { state.step = Number(event.target.value); show(); remember(); }});
  element("time").oninput = event => { Object.assign(state, {time: event.target.value / 1000 * duration, free: null, view: null}); show(); remember(); };
  if (settings.views.length) element("views").onchange = event => { event.target.value === "" ? act("home") : goTo(Number(event.target.value)); canvas.focus(); };
  element("path").hidden = !duration;
  element("about").onclick = event => { if (event.target === event.currentTarget) event.currentTarget.close(); };  // outside of the dialog
  canvas.addEventListener("webglcontextlost", () => failed(new Error("the graphics card has stopped; reload the page")));
  let hiding = 0;
  const wake = () => {  // in full screen, what lies over the picture goes after a while
    document.body.classList.remove("idle");
    clearTimeout(hiding);
    hiding = setTimeout(() => document.body.classList.toggle("idle", Boolean(document.fullscreenElement)), 3000);
  };
  for (const kind of ["pointermove", "pointerdown", "keydown", "focusin", "fullscreenchange"]) addEventListener(kind, wake);
}

// The latest answer of the worker is drawn again and again; while it works on the next one, the view stays fluid.
function run() {
  let latest = null, pending = false, last = performance.now(), drawn = "", pace = 0;
  const turn = now => {
    if (hasFailed) return;
    const seconds = Math.min((now - last) / 1000, 0.1), before = `${state.time}${JSON.stringify(state.free)}`;
    pace += 0.1 * (now - last - pace);
    last = now;
    if (state.playing) {
      state.time += seconds;
      if (duration && state.time > duration) state.time %= duration;
    }
    move(seconds);
    const moves = state.playing || keys.size > 0 || `${state.time}${JSON.stringify(state.free)}` !== before;
    if (!moves) { pixels = 1; pace = 0; }
    else if (pace > SLOW_MS && pixels > COARSEST) { pixels = Math.max(0.75 * pixels, COARSEST); pace = 0; }
    fit();
    const camera = withSize(state.free ?? pathCamera(state.time), canvas.width, canvas.height);
    if (!pending) {
      const request = JSON.stringify([camera, state.time, state.step]);
      if (!latest || latest.request !== request) {
        pending = true;
        answer(camera, state.time, state.step).then(found => { latest = {...found, request}; pending = false; });
      }
    }
    const picture = latest && JSON.stringify([latest.request, camera, state.split]);
    if (latest && picture !== drawn) {
      draw(camera, latest, state.split ?? 0);
      drawn = picture;
      element("notice").hidden = true;
    }
    if (state.playing) show();
    requestAnimationFrame(turn);
  };
  requestAnimationFrame(turn);
}

let opened = 0;
const ready = open(words => {
  element("doing").textContent = words;
  element("loaded").value = 0.7 + 0.1 * opened++;  // what is before is the page itself
  return new Promise(resolve => setTimeout(resolve, 30));
});
window.gsrain = {ready, image, view: () => textOf(state), drops: time => answer(withSize(pathCamera(time), canvas.width, canvas.height), time, state.step, true)};
ready.then(() => {
  wire();
  follow();
  if (location.hash.includes("still")) { element("notice").hidden = true; return; }
  element("doing").textContent = "Placing the drops";
  run();
}).catch(failed);
