// Mirror of wet ground: a small picture of the scene by a camera below it, and what the water reflects of that. The formulas
// are those of gsrain_engine/water/mirror.py and leveled_ground.py, which have the sources. Lengths in meters.

const LOWEST_CAMERA = 0.05;  // over the ground
const AHEAD = 8, AROUND = 6, AROUND_PER_HEIGHT = 2, REACH = 2.5, PLANE_STEP = 0.5, RIDGE = 1e-3, DRY = 0.1;  // of the plane of uneven ground

let ground = null, mirrorImages = null;

// Heights and shares of film and standing water (in 1/255) of the cells of the ground's map; null without a map.
async function openGround(files) {
  const {map} = settings;
  if (!map) return null;
  const pixels = await pixelsOfFile(files["ground.webp"]), cells = map.rows * map.columns, [film, standing] = [new Uint8Array(cells), new Uint8Array(cells)];
  const heights = new Float32Array(cells);
  for (let k = 0; k < cells; ++k) {
    heights[k] = map.lowest + map.step * (pixels[4 * k] + 256 * pixels[4 * k + 1]);
    film[k] = pixels[4 * k + 2];
    standing[k] = pixels[4 * k + 3];
  }
  return ground = {map, heights, film, standing};
}

// Data of the mirror, out of the page's files: textures of the water on each Gaussian, of facets and of the ground below each.
async function openMirror(files, places, textures) {
  if (!settings.mirror) {
    Object.assign(textures, {water: emptyTexture(), floors: emptyTexture(), reflected: texture(gl.R32UI, 1, 1)});
    return null;
  }
  const count = places.length / 3;
  textures.water = await imageTexture(files["water.webp"]);
  scene.facets = texture(gl.RGB32F, 128, settings.states.length + 1, gl.RGB, gl.FLOAT, new Float32Array(files.facets.buffer));
  scene.actorFloors = new Float32Array(files.floors.buffer);
  const codes = pixelsOf(textures.water), reflected = Uint32Array.from({length: count}, (_, i) => i).filter(i => codes[4 * i + 2] > 0);
  scene.reflected = reflected.length;
  textures.reflected = texture(gl.R32UI, COLUMNS, rowsFor(reflected.length, COLUMNS));
  upload(textures.reflected, COLUMNS, 1, reflected.map(i => i | codes[4 * i + 2] << 24), gl.RED_INTEGER, gl.UNSIGNED_INT);
  if (!settings.mirror.isUneven) {
    textures.floors = emptyTexture();
    return {reflected, floors: null};
  }
  const floors = new Float32Array(COLUMNS * rowsFor(count, COLUMNS));
  for (let i = 0; i < count; ++i) floors[i] = heightAt(places[3 * i], places[3 * i + 1]);
  textures.floors = texture(gl.R32F, COLUMNS, floors.length / COLUMNS, gl.RED, gl.FLOAT, floors);
  return {reflected, floors};
}

function heightAt(x, y) {  // of uneven ground, linear between the middles of cells
  const {corner, cell, rows, columns} = settings.map, {heights} = ground;
  const u = Math.min(Math.max((x - corner[0]) / cell - 0.5, 0), columns - 1), v = Math.min(Math.max((y - corner[1]) / cell - 0.5, 0), rows - 1);
  const left = Math.min(Math.floor(u), Math.max(columns - 2, 0)), low = Math.min(Math.floor(v), Math.max(rows - 2, 0));
  const right = Math.min(left + 1, columns - 1), high = Math.min(low + 1, rows - 1), part = u - left;
  const along = row => (1 - part) * heights[row * columns + left] + part * heights[row * columns + right];
  return along(low) + (v - low) * (along(high) - along(low));
}

// A camera over level ground at a height; over uneven ground the world is turned so that the plane before the camera is level.
function leveled(camera) {
  if (!settings.mirror.isUneven) return {camera, height: settings.mirror.ground};
  const {corner, cell, rows, columns} = settings.map, [x, y, z] = camera.position, below = heightAt(x, y);
  const around = AROUND + AROUND_PER_HEIGHT * Math.max(z - below, 0), stride = Math.max(Math.floor(PLANE_STEP / cell), 1);
  const middle = [0, 1].map(k => camera.position[k] + AHEAD * camera.axes[2][k]);
  const [firstX, firstY] = middle.map((each, k) => Math.max(Math.trunc((each - REACH * around - corner[k]) / cell), 0));
  const [lastX, lastY] = middle.map((each, k) => Math.min(Math.trunc((each + REACH * around - corner[k]) / cell) + 1, k ? rows : columns));
  const sums = [[0, 0, 0], [0, 0, 0], [0, 0, 0]], values = [0, 0, 0];
  for (let row = firstY; row < lastY; row += stride)
    for (let column = firstX; column < lastX; column += stride) {
      const px = corner[0] + (column + 0.5) * cell, py = corner[1] + (row + 0.5) * cell, at = row * columns + column;
      const weight = (DRY + Math.max(ground.film[at], ground.standing[at]) / 255) * Math.exp(-0.5 * ((px - middle[0]) ** 2 + (py - middle[1]) ** 2) / around ** 2);
      const terms = [1, (px - x) / around, (py - y) / around];
      for (let k = 0; k < 3; ++k) {
        values[k] += weight * terms[k] * (ground.heights[at] - below);
        for (let j = 0; j < 3; ++j) sums[k][j] += weight * terms[k] * terms[j];
      }
    }
  if (!(sums[0][0] > 0)) return {camera, height: below};
  sums[1][1] += RIDGE * sums[0][0];
  sums[2][2] += RIDGE * sums[0][0];
  const [rise, slopeX, slopeY] = solved(sums, values), length = Math.hypot(slopeX / around, slopeY / around, 1);
  const turn = upright([-slopeX / around / length, -slopeY / around / length, 1 / length]), foot = [x, y, below + rise];
  const shift = times(turn, foot).map((each, k) => foot[k] - each);
  const position = times(turn, camera.position).map((each, k) => each + shift[k]);
  return {camera: {...camera, position, axes: camera.axes.map(axis => times(turn, axis))}, height: foot[2]};
}

function solved(matrix, values) {  // of three linear equations, by Cramer's rule
  const determinant = ([a, b, c]) => a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0]);
  const whole = determinant(matrix);
  return [0, 1, 2].map(k => determinant(matrix.map((row, j) => row.map((each, i) => i === k ? values[j] : each))) / whole);
}

const upright = ([a, b, c]) => [  // smallest turn of a direction upward
  [1 - a * a / (1 + c), -a * b / (1 + c), -a], [-a * b / (1 + c), 1 - b * b / (1 + c), -b], [a, b, c]];

// The mirror of a camera: `below` is the camera that sees what level ground reflects, with the rows of the ground only, from the
// lowest to the highest; the rest is of the mirror image, from its uppermost row on. Null where no ground is in view.
function mirrorOf(camera) {
  if (!settings.mirror) return null;
  const {camera: level, height} = leveled(camera), [across, along] = settings.mirror.scales, above = level.position[2] - height;
  const upward = level.axes.map(axis => axis[2]), {fx, fy, cx, cy} = camera;
  const isGround = row => [0, camera.width].some(x => upward[0] * (x - cx) / fx + upward[1] * ((row + 0.5) / along - cy) / fy + upward[2] < 0);
  const rows = Array.from({length: Math.max(Math.ceil(along * camera.height), 1)}, (_, row) => row).filter(isGround);
  if (!(above > LOWEST_CAMERA) || !rows.length) return null;
  const first = rows[0], last = rows.at(-1) + 1, [right, down, ahead] = level.axes, [x, y, z] = level.position;
  const below = {
    ...level, position: [x, y, 2 * height - z], axes: [[right[0], right[1], -right[2]], [-down[0], -down[1], down[2]], [ahead[0], ahead[1], -ahead[2]]],
    width: Math.max(Math.ceil(across * camera.width), 1), height: last - first,
    fx: across * fx, fy: along * fy, cx: across * cx, cy: last - along * cy,
  };
  return {below, ground: height, above, upward, first_row: first, mirror_size: [below.width, below.height],
          intrinsics: [across * fx, along * fy, across * cx, along * cy - first]};
}

function makeMirrorImages(width, height) {
  if (mirrorImages && mirrorImages.width === width && mirrorImages.height >= height) return;
  if (mirrorImages) mirrorImages.all.forEach(each => gl.deleteTexture(each));
  const all = Array.from({length: 5}, () => texture(half ? gl.RGBA16F : gl.RGBA32F, width, height)), [light, ...waters] = all;
  mirrorImages = {width, height, all, light, columns: waters.slice(0, 2), rows: waters.slice(2),
                  lightTarget: target(light), columnsTarget: target(...waters.slice(0, 2)), rowsTarget: target(...waters.slice(2))};
}

// Draws the light that films and standing water reflect into a camera; the scene by means of the screen's images.
function drawMirror(mirror, camera, drawn, rain) {
  const {below, upward, mirror_size, intrinsics, above} = mirror, [width, height] = mirror_size, rows = makeRoom(0), view = projection(below);
  makeMirrorImages(width, Math.max(height, Math.ceil(settings.mirror.scales[1] * camera.height)));
  const far = {medium_numbers: drawn.numbers, medium_drawn: new Float32Array(64), medium_floor: [0, 0, 0, 1e9], airlight: linear(rain.airlight)};
  projectScene(view, far, drawn, rain, rowsFor(scene.reflected, COLUMNS), mirror);
  blendSplats(screen.wetTarget, view, far, rain, drawn.reflected, rows, {from: 0, to: width, falls: false, is_mirrored: true});
  gl.disable(gl.BLEND);
  gl.disable(gl.SCISSOR_TEST);
  gl.viewport(0, 0, width, height);
  const {light, columns: [films, standing]} = mirrorImages, image = {upward, mirror_size, intrinsics, light, films, standing};
  const pass = (to, program, values) => {
    gl.bindFramebuffer(gl.FRAMEBUFFER, to);
    program.use(values);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  };
  pass(mirrorImages.lightTarget, programs.mirrorLight, {upward, mirror_size, intrinsics, above, sky: rain.mirror.sky, picture: screen.scene, depths: screen.visible});
  pass(mirrorImages.columnsTarget, programs.mirrorColumns, {upward, mirror_size, intrinsics, light, facets: scene.facets, standing_row: settings.states.indexOf(rain) + 1});
  pass(mirrorImages.rowsTarget, programs.mirrorRows, {...image, slopes: rain.mirror.slopes, weights: rain.mirror.weights});
}
