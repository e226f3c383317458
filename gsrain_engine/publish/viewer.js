"use strict";
// Draws a SOG scene and its rain with WebGL 2, by the shaders of the desktop. Rain and depth order come from the worker (rain.js).

const settings = JSON.parse(document.getElementById("settings").textContent);
const COLUMNS = settings.splatColumns, STREAK_COLUMNS = settings.streakColumns, STREAK_FLOATS = 12, NEAR = settings.near;
const element = name => document.getElementById(name), canvas = element("view");
const gl = canvas.getContext("webgl2", {alpha: false, antialias: false, powerPreference: "high-performance", preserveDrawingBuffer: true});

// Textures and programs

function texture(internal, width, height, format, type, pixels = null) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texStorage2D(gl.TEXTURE_2D, 1, internal, width, height);
  if (pixels) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, format, type, pixels);
  for (const [name, value] of [["MIN_FILTER", "NEAREST"], ["MAG_FILTER", "NEAREST"], ["WRAP_S", "CLAMP_TO_EDGE"], ["WRAP_T", "CLAMP_TO_EDGE"]])
    gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}`], gl[value]);
  return Object.assign(made, {width, height});
}

const emptyTexture = () => texture(gl.RGBA8, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));

async function imageTexture(bytes) {  // the bytes of a lossless image, as they are
  const bitmap = await createImageBitmap(
    new Blob([bytes], {type: "image/webp"}), {premultiplyAlpha: "none", colorSpaceConversion: "none"});
  return texture(gl.RGBA8, bitmap.width, bitmap.height, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
}

async function pixelsOfFile(bytes) {
  const image = await imageTexture(bytes), pixels = pixelsOf(image);
  gl.deleteTexture(image);
  return pixels;
}

function target(...textures) {
  const made = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, made);
  textures.forEach((each, k) => gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + k, gl.TEXTURE_2D, each, 0));
  gl.drawBuffers(textures.map((_, k) => gl.COLOR_ATTACHMENT0 + k));
  return made;
}

function pixelsOf(image) {
  const framebuffer = target(image), pixels = new Uint8Array(4 * image.width * image.height);
  gl.readPixels(0, 0, image.width, image.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  gl.deleteFramebuffer(framebuffer);
  return pixels;
}

// Soaked base colors of differences from the dry ones (`wet_files` in page_scene.py).
function addSteps(differences, base, steps) {
  const sums = pixelsOf(differences), dry = pixelsOf(base);
  for (let k = 0; k < sums.length; ++k) if ((k & 3) < 3) sums[k] += steps[dry[k]];
  gl.bindTexture(gl.TEXTURE_2D, differences);
  gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, differences.width, differences.height, gl.RGBA, gl.UNSIGNED_BYTE, sums);
}

class Program {
  constructor(vertex, fragment) {
    this.program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(this.program, shader);
    }
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(this.program));
    this.uniforms = {};
    for (let k = gl.getProgramParameter(this.program, gl.ACTIVE_UNIFORMS) - 1; k >= 0; --k) {
      const {name, type} = gl.getActiveUniform(this.program, k), plain = name.replace("[0]", "");
      this.uniforms[plain] = {place: gl.getUniformLocation(this.program, name), type};
    }
  }

  use(values) {  // numbers, arrays of numbers and textures
    gl.useProgram(this.program);
    let unit = 0;
    for (const [name, value] of Object.entries(values)) {
      const uniform = this.uniforms[name];
      if (!uniform) continue;
      const {place, type} = uniform;
      if (value instanceof WebGLTexture) {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(gl.TEXTURE_2D, value);
        gl.uniform1i(place, unit++);
      } else if (type === gl.FLOAT_MAT4) gl.uniformMatrix4fv(place, false, value);
      else if (type === gl.FLOAT) typeof value === "number" ? gl.uniform1f(place, value) : gl.uniform1fv(place, value);
      else if (type === gl.INT || type === gl.BOOL) gl.uniform1i(place, value);
      else if (type === gl.INT_VEC2) gl.uniform2iv(place, value);
      else gl[`uniform${value.length}fv`](place, value);
    }
  }
}

// Small matrices, as rows

const times = (m, v) => m.map(row => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
const transposed = m => [0, 1, 2].map(k => m.map(row => row[k]));
const product = (m, n) => m.map(row => [0, 1, 2].map(k => row[0] * n[0][k] + row[1] * n[1][k] + row[2] * n[2][k]));
function rotationOf([w, x, y, z]) {
  return [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
          [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
          [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]];
}

// Camera: position, axes (right, down, forward) in the world, vertical field of view (degrees), velocity (m/s)

function pathCamera(time) {
  const {path, pathStep} = settings, at = Math.min(time / pathStep, path.length - 1), k = Math.min(Math.floor(at), path.length - 2);
  if (k < 0) return {position: path[0].slice(0, 3), axes: transposed(rotationOf(path[0].slice(3, 7))), fov: path[0][7], velocity: path[0].slice(8), floor: settings.floors[0]};
  const [a, b, share] = [path[k], path[k + 1], at - k];
  const mixed = a.map((each, i) => each + share * (b[i] - each)), turn = mixed.slice(3, 7), norm = Math.hypot(...turn);
  return {position: mixed.slice(0, 3), axes: transposed(rotationOf(turn.map(each => each / norm))), fov: mixed[7], velocity: mixed.slice(8), floor: settings.floors[k]};
}

function withSize(camera, width, height) {
  const focal = height / 2 / Math.tan(camera.fov * Math.PI / 360);
  return {...camera, width, height, fx: focal, fy: focal, cx: width / 2, cy: height / 2};
}

// Numbers of the actors at a time of the path, `per` each: rows of matrices from their first place, in the file's frame (NaN where
// absent), or heights of uneven ground below them.
function actorsAt(time, all, per) {
  const {steps} = scene.poses, found = new Float32Array(per * settings.actors);
  const at = Math.min(time / settings.poseStep, steps - 1), k = Math.min(Math.floor(at), Math.max(steps - 2, 0)), share = at - k;
  for (let actor = 0; actor < settings.actors; ++actor)
    for (let i = 0; i < per; ++i) {
      const a = all[per * (actor * steps + k) + i], b = all[per * (actor * steps + Math.min(k + 1, steps - 1)) + i];
      found[per * actor + i] = share > 0 ? a + share * (b - a) : a;
    }
  return found;
}

// Opening

let worker = null, waiting = new Map(), requests = 0, scene = {}, programs = null, screen = null, half = null;

function answer(camera, time, step, drops = false) {  // of the worker
  const id = ++requests;
  const promise = new Promise(resolve => waiting.set(id, resolve));
  const poses = settings.actors ? actorsAt(time, scene.poses.all, 12) : null, {rotation, origin} = settings.toWorld;
  const mirror = settings.states[step].mirror && mirrorOf(camera), floors = poses && scene.actorFloors && actorsAt(time, scene.actorFloors, 1);
  worker.postMessage({id, camera, time: settings.start + time, state: step, near: NEAR, drops, poses, rotation, origin, floors,
                      mirror: mirror && {below: mirror.below, ground: mirror.ground}});
  return promise;
}

// Opens the page's scene; `report` is called with what is done next, and waits for the screen to show it.
async function open(report) {
  if (!gl) throw new Error("this browser has no WebGL 2");
  if (!gl.getExtension("EXT_color_buffer_float")) throw new Error("this graphics card draws no floating-point images");
  half = !gl.getExtension("EXT_float_blend");
  await report("Unpacking");
  const all = await unzipped(bytesOf(element("data").textContent)), read = file => JSON.parse(new TextDecoder().decode(file));
  element("data").remove();
  await report("Decoding images");
  const files = await unzipped(all["scene.sog"]), meta = read(files["meta.json"]);
  const wetFile = name => all[`wet/${name}`], wet = settings.hasWet ? read(wetFile("meta.json")) : {};
  const image = (file, part, k) => part ? imageTexture(file(part.files[k])) : emptyTexture(), scenes = name => files[name];
  const books = [meta.scales, meta.sh0, meta.shN, wet.sh0, wet.shN].map(part => part ? part.codebook : new Array(256).fill(0));
  const textures = {
    scales: await image(scenes, meta.scales, 0), quaternions: await image(scenes, meta.quats, 0), base: await image(scenes, meta.sh0, 0),
    centroids: await image(scenes, meta.shN, 0), labels: await image(scenes, meta.shN, 1),
    wet_base: await image(wetFile, wet.sh0, 0), wet_centroids: await image(wetFile, wet.shN, 0),
    wet_labels: await image(wetFile, wet.shN, 1),
    codebooks: texture(gl.R32F, 256, 5, gl.RED, gl.FLOAT, Float32Array.from(books.flat())),
  };
  if (settings.hasWet) addSteps(textures.wet_base, textures.base, wet.sh0.dry_steps);
  if (settings.actors) {
    textures.actors = await imageTexture(all["actors.webp"]);
    textures.poses = texture(gl.RGBA32F, 4, settings.actors + 1);
    const poses = new Float32Array(all.poses.buffer);
    scene.poses = {all: poses, steps: poses.length / settings.actors / 12};
  } else textures.actors = textures.poses = emptyTexture();
  const harmonics = part => part ? [1, 4, 9, 16][part.bands] : 1;
  const count = meta.count, {mins, maxs} = meta.means, {parts} = settings;
  Object.assign(scene, {count, textures, coefficients: harmonics(meta.shN), wet_coefficients: harmonics(wet.shN)});
  const [low, high, part] = await Promise.all([files[meta.means.files[0]], files[meta.means.files[1]], all["mean_parts.webp"]].map(pixelsOfFile));
  const means = new Float32Array(4 * COLUMNS * rowsFor(count, COLUMNS)), fixed = new Float32Array(3 * count);
  const {rotation, origin} = settings.toWorld, place = [0, 0, 0];
  for (let i = 0; i < count; ++i) {
    for (let k = 0; k < 3; ++k) {
      const steps = low[4 * i + k] + 256 * high[4 * i + k] + (part[4 * i + k] + 0.5) / parts[k] - 0.5;
      const value = mins[k] + (maxs[k] - mins[k]) * steps / 65535;
      means[4 * i + k] = place[k] = Math.sign(value) * Math.expm1(Math.abs(value));
    }
    for (let k = 0; k < 3; ++k)
      fixed[3 * i + k] = rotation[k][0] * place[0] + rotation[k][1] * place[1] + rotation[k][2] * place[2] + origin[k];
  }
  textures.means = texture(gl.RGBA32F, COLUMNS, rowsFor(count, COLUMNS), gl.RGBA, gl.FLOAT, means);
  const ground = await openGround(all), mirror = await openMirror(all, fixed, textures), impacts = new Float32Array(all.impacts.buffer);
  await report("Preparing the graphics card");
  worker = new Worker(URL.createObjectURL(new Blob([element("rain-script").textContent], {type: "text/javascript"})));
  worker.onmessage = ({data}) => { waiting.get(data.id)(data); waiting.delete(data.id); };
  worker.onerror = ({message}) => failed(new Error(message));
  const actors = settings.actors ? pixelsOf(textures.actors) : null;
  const members = actors && Uint16Array.from({length: count}, (_, i) => actors[4 * i] + 256 * actors[4 * i + 1]);
  if (settings.rain.roofs) settings.rain.roofs.heights = new Float32Array(all.roofs.buffer);
  worker.postMessage({fixed, members, mirror, ground, impacts, states: settings.states, settings: settings.rain});
  const text = name => element(name).textContent;
  programs = {
    scene: new Program(text("page_quad.vert"), text("page_project.frag")),
    streaks: new Program(text("page_quad.vert"), text("page_project.frag streaks")),
    sky: new Program(text("page_quad.vert"), text("page_sky.frag")),
    splats: new Program(text("page_splat.vert"), text("page_splat.frag")),
    mirrorLight: new Program(text("page_quad.vert"), text("page_mirror_light.frag")),
    mirrorColumns: new Program(text("page_quad.vert"), text("page_mirror_columns.frag")),
    mirrorRows: new Program(text("page_quad.vert"), text("page_mirror_rows.frag")),
    picture: new Program(text("page_quad.vert"), text("page_picture.frag")),
  };
  const corners = Uint16Array.from({length: 128 * 6}, (_, k) => 4 * Math.floor(k / 6) + [0, 1, 2, 2, 1, 3][k % 6]);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
}

const rowsFor = (count, columns) => Math.max(1, Math.ceil(count / columns));

function makeRoom(streaks) {  // data textures: splats of the scene, then of streaks; streaks; the order
  const rows = rowsFor(scene.count, COLUMNS);
  if (!scene.room || streaks > scene.room) {
    const room = scene.room = Math.max(65536, 2 * streaks), more = rowsFor(room, COLUMNS);
    for (const old of [scene.shapes, scene.rests, scene.streaks, scene.order]) gl.deleteTexture(old ?? null);
    scene.shapes = texture(gl.RGBA32UI, COLUMNS, rows + more);
    scene.rests = texture(gl.RGBA32UI, COLUMNS, rows + more);
    scene.streaks = texture(gl.RGBA32F, 3 * STREAK_COLUMNS, rowsFor(room, STREAK_COLUMNS));
    scene.order = texture(gl.R32UI, COLUMNS, rowsFor(scene.count + room, COLUMNS));
    scene.target = target(scene.shapes, scene.rests);
  }
  return rows;
}

function upload(image, columns, per, data, format, type) {  // rows of a texture, the last one padded
  const rows = rowsFor(data.length / per, columns), padded = new data.constructor(rows * columns * per);
  padded.set(data);
  gl.bindTexture(gl.TEXTURE_2D, image);
  gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, image.width, rows, format, type, padded);
}

function makeScreen(width, height) {
  if (screen && screen.width === width && screen.height === height) return;
  if (screen) [screen.scene, screen.shares, screen.visible].forEach(each => gl.deleteTexture(each));
  const made = () => texture(half ? gl.RGBA16F : gl.RGBA32F, width, height);
  screen = {width, height, scene: made(), shares: made(), visible: settings.mirror ? made() : emptyTexture()};
  screen.target = target(screen.scene, screen.shares);
  screen.wetTarget = settings.mirror && target(screen.scene, screen.shares, screen.visible);
}

function projection(camera) {
  const {rotation, origin} = settings.toWorld, turn = product(camera.axes, rotation);
  const shift = times(camera.axes, origin.map((each, k) => each - camera.position[k]));
  const matrix = [0, 1, 2].flatMap(k => [turn[0][k], turn[1][k], turn[2][k], 0]).concat(shift, 1);
  return {object_to_camera: matrix, intrinsics: [camera.fx, camera.fy, camera.cx, camera.cy],
          image_size: [camera.width, camera.height], near: NEAR};
}

// From the frame of one camera to that of another.
function moved(from, to) {
  const turn = product(to.axes, transposed(from.axes)), shift = times(to.axes, from.position.map((each, k) => each - to.position[k]));
  return {moved: [0, 1, 2].flatMap(k => [turn[0][k], turn[1][k], turn[2][k], 0]).concat(shift, 1)};
}

const linear = color => color.map(c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);

// Projects the Gaussians of the scene, in a mirror those that it shows.
function projectScene(view, medium, drawn, rain, rows, mirror = null) {
  if (settings.actors) uploadPoses(drawn.poses, drawn.floors);
  gl.disable(gl.BLEND);
  gl.disable(gl.SCISSOR_TEST);
  gl.bindFramebuffer(gl.FRAMEBUFFER, scene.target);
  gl.viewport(0, 0, COLUMNS, rows);
  programs.scene.use({...view, ...medium, ...scene, ...scene.textures, first_row: 0, count: mirror ? scene.reflected : scene.count, has_actors: settings.actors > 0, wetness: settings.hasWet ? rain.wetness : 0,
                      antialiased: settings.antialiased, has_medium: rain.extinction > 0, is_mirrored: Boolean(mirror), is_uneven: Boolean(mirror && settings.mirror.isUneven),
                      level: [...settings.toWorld.rotation[2], mirror ? mirror.ground : 0], growth_steps: mirror ? settings.mirror.growthSteps : 1});
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}

// Blends what is projected, in an order, into the columns of an image up to `to`.
function blendSplats(image, view, medium, rain, ids, rows, {from, to, falls, is_mirrored}) {
  const [width, height] = view.image_size;
  upload(scene.order, COLUMNS, 1, ids, gl.RED_INTEGER, gl.UNSIGNED_INT);
  gl.bindFramebuffer(gl.FRAMEBUFFER, image);
  gl.viewport(0, 0, width, height);
  gl.enable(gl.SCISSOR_TEST);
  gl.scissor(from, 0, to - from, height);
  for (let k = 0; k < 3; ++k) gl.clearBufferfv(gl.COLOR, k, [0, 0, 0, 0]);
  if (rain.extinction > 0) {
    programs.sky.use({...view, ...medium});
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
  gl.enable(gl.BLEND);
  gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  programs.splats.use({shapes: scene.shapes, rests: scene.rests, order: scene.order, image_size: view.image_size, falls, is_mirrored,
                       water: scene.textures.water, drawn_count: ids.length, scene_count: scene.count, first_streak_row: rows});
  gl.drawElementsInstanced(gl.TRIANGLES, 128 * 6, gl.UNSIGNED_SHORT, 0, Math.ceil(ids.length / 128));
  gl.disable(gl.BLEND);
}

// Draws one state of the rain into the columns of the canvas from `left` to `right` (shares of the width).
function drawPart(camera, drawn, rain, left, right) {
  const count = drawn.streaks.length / STREAK_FLOATS, rows = makeRoom(count), view = projection(camera), falls = rain.density > 0 || Boolean(rain.splashes);
  const medium = {medium_numbers: drawn.numbers, medium_drawn: drawn.drawn, medium_floor: drawn.floor, airlight: linear(rain.airlight)};
  const mirror = rain.mirror && drawn.reflected ? mirrorOf(camera) : null;
  if (mirror) drawMirror(mirror, camera, drawn, rain);
  projectScene(view, medium, drawn, rain, rows);
  if (falls && count) {
    upload(scene.streaks, STREAK_COLUMNS, STREAK_FLOATS, drawn.streaks, gl.RGBA, gl.FLOAT);
    gl.bindFramebuffer(gl.FRAMEBUFFER, scene.target);
    gl.viewport(0, rows, COLUMNS, rowsFor(count, COLUMNS));
    programs.streaks.use({...view, ...moved(drawn.camera, camera), streaks: scene.streaks, first_row: rows, count, display_color: rain.drops});
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
  const [from, to] = [left, right].map(share => Math.round(share * camera.width));
  blendSplats(mirror ? screen.wetTarget : screen.target, view, medium, rain, drawn.ids, rows, {from, to, falls, is_mirrored: false});
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.viewport(0, 0, canvas.width, canvas.height);
  gl.scissor(Math.round(left * canvas.width), 0, Math.round(right * canvas.width) - Math.round(left * canvas.width), canvas.height);
  const [films, standing] = mirror ? mirrorImages.rows : [scene.textures.water, scene.textures.water];
  programs.picture.use({clear_scene: screen.scene, shares: screen.shares, rain_light: linear(rain.drops), screen: [canvas.width, canvas.height],
                        water: screen.visible, films, standing, mirror_size: mirror ? mirror.mirror_size : [0, 0],
                        mirror_scales: mirror ? settings.mirror.scales : [1, 1], first_row: mirror ? mirror.first_row : 0});
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}

function uploadPoses(poses, floors) {  // three rows of an actor's matrix, and the height of uneven ground below it; row 0 is of what does not move
  const rows = new Float32Array(16 * (settings.actors + 1));
  rows.set([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]);
  for (let actor = 0; actor < settings.actors; ++actor) {
    rows.set(poses.subarray(12 * actor, 12 * actor + 12), 16 * (actor + 1));
    if (floors) rows[16 * (actor + 1) + 12] = floors[actor];
  }
  gl.bindTexture(gl.TEXTURE_2D, scene.textures.poses);
  gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, 4, settings.actors + 1, gl.RGBA, gl.FLOAT, rows);
}

function draw(camera, drawn, split) {
  makeScreen(camera.width, camera.height);
  if (split > 0) drawPart(camera, {...drawn, streaks: new Float32Array(0)}, settings.states[0], 0, split);
  if (split < 1) drawPart(camera, drawn, settings.states[drawn.state], split, 1);
}
