// Splashes of the page: drops that land on wet ground near the camera, as Gaussians among those of streaks. The same integers and the
// same formulas as in gsrain_engine/water (impacts.py, splashes.py), which have the sources. Part of the worker, after rain.js.

const WATER = 998, TENSION = 0.0728, VISCOSITY = 1e-3, KNOTS = 512, TICK = 1 / 32, SIZE_STRIDE = 0x9E3779B9 | 0;  // cells have 1 m
const SPLASH_REACH = 20, SMALLEST_PX = 0.3, LIFE = 1.2, COVERAGE = 0.5, SEGMENTS = 8, RING_PX = 3, DROPLETS = 8, FLIGHT = 0.4, GOLDEN = 2.399963;
const LARGEST_LANDING = 6;  // mm
const WHOLE = 2 ** -32;

const splashNumber = (mm, speed) => WATER * speed * speed * 1e-3 * mm / TENSION * (VISCOSITY / Math.sqrt(WATER * TENSION * 1e-3 * mm)) ** -0.4;
const crownLife = mm => LIFE * Math.sqrt(WATER * (1e-3 * mm) ** 3 / TENSION);
const between = (value, low, high) => Math.min(Math.max(value, low), high);

function crownSize(age, {mm, speed, film}) {  // radius and height
  const diameter = 1e-3 * mm, radius = diameter * (2 / (3 * between(film / mm, 0.1, 1))) ** 0.25 * Math.sqrt(speed * age / diameter);
  const part = between(age / crownLife(mm), 0, 1);
  return [radius, diameter * Math.sqrt(WATER * speed * speed * diameter / TENSION / 200) * 4 * part * (1 - part)];
}

class Splashes {
  // `ground`: map, heights and shares of film and standing water of its cells; null is all wet, at the settings' height.
  constructor(rain, sizes, ground) {
    Object.assign(this, {rain, sizes, ground, settings: rain.settings, depths: rain.state.splashes});
  }

  _cell(x, y) {  // number of the map's cell at a place; -1 outside
    const {corner, cell, rows, columns} = this.ground.map, column = Math.floor((x - corner[0]) / cell), row = Math.floor((y - corner[1]) / cell);
    return column >= 0 && column < columns && row >= 0 && row < rows ? row * columns + column : -1;
  }

  _below([x, y]) {  // height of the ground below a camera
    if (!this.ground) return this.settings.ground;
    const {corner, cell, rows, columns} = this.ground.map, at = (value, k, count) => corner[k] + cell * (between(Math.floor((value - corner[k]) / cell), 0, count - 1) + 0.5);
    return this.ground.heights[this._cell(at(x, 0, columns), at(y, 1, rows))];
  }

  // Calls `use` with each impact in view that splashes, of the time `past` up to the end of the exposure.
  _landed(time, camera, past, reach, use) {
    const {rain, sizes, ground, settings} = this, {rate, film, dip} = this.depths, half = settings.exposure / 2;
    const start = time - half - past, end = time + half, firstTick = Math.floor(start / TICK), lastTick = Math.ceil(end / TICK);
    const eye = camera.position, [right, down, ahead] = camera.axes, low = this._below(eye) - eye[2];
    const left = -camera.cx / camera.fx, rightmost = (camera.width - camera.cx) / camera.fx;
    const top = -camera.cy / camera.fy, bottom = (camera.height - camera.cy) / camera.fy;
    const wide = Math.hypot(1, Math.max(-left, rightmost)), high = Math.hypot(1, Math.max(-top, bottom));
    const along = (axis, x, y) => axis[0] * x + axis[1] * y + axis[2] * low;
    const land = (cellX, cellY, tick) => {
      let larger = 0;
      for (let number = 1; ; ++number) {
        hash(cellX, cellY, tick, settings.seed ^ Math.imul(number, SIZE_STRIDE));
        larger -= Math.log(hashX * WHOLE + WHOLE / 2) / TICK;
        if (larger >= rate) return;
        const landing = (tick + hashW * WHOLE) * TICK, x = cellX + hashY * WHOLE, y = cellY + hashZ * WHOLE;
        if (landing < start || landing >= end) continue;
        const cell = ground ? this._cell(x, y) : 0, standing = ground && cell >= 0 ? ground.standing[cell] : 0;
        if (ground && (cell < 0 || !(ground.film[cell] || standing))) continue;
        const at = Math.sqrt(Math.sqrt(larger / rate)) * (KNOTS - 1), k = Math.min(Math.trunc(at), KNOTS - 2), part = at - k;
        const [mm, speed] = [0, 1].map(row => sizes[2 * k + row] + part * (sizes[2 * k + 2 + row] - sizes[2 * k + row]));
        const depth = film + standing / 255 * (dip - film), z = ground ? ground.heights[cell] : settings.ground;
        if (splashNumber(mm, speed) <= 2100 + 5880 * Math.min(depth / mm, 1) ** 1.44) continue;
        if (settings.roofs && rain._isSheltered(x, y, z)) continue;
        use({x, y, z, landing, mm, speed, film: depth, own: (hashX ^ hashY ^ Math.imul(hashZ, SIZE_STRIDE)) >>> 0});
      }
    };
    for (let cellX = Math.floor(eye[0] - reach); cellX <= Math.floor(eye[0] + reach); ++cellX)
      for (let cellY = Math.floor(eye[1] - reach); cellY <= Math.floor(eye[1] + reach); ++cellY) {
        const dx = cellX + 0.5 - eye[0], dy = cellY + 0.5 - eye[1], depth = along(ahead, dx, dy), u = along(right, dx, dy), v = along(down, dx, dy);
        if (Math.hypot(dx, dy) >= reach + 1 || depth <= -1 || u <= left * depth - wide || u >= rightmost * depth + wide) continue;
        if (v <= top * depth - high || v >= bottom * depth + high) continue;
        for (let tick = firstTick; tick < lastTick; ++tick) land(cellX, cellY, tick);
      }
  }

  // Adds crowns and droplets at a time to the rows of a camera.
  add(rows, time, camera) {
    const {settings, rain} = this, focal = rows.shutter.focal, eye = camera.position, half = settings.exposure / 2;
    const distance = (x, y, z) => Math.max(Math.hypot(x - eye[0], y - eye[1], z - eye[2]), 0.1);
    this._landed(time, camera, crownLife(LARGEST_LANDING), SPLASH_REACH, drop => {
      const life = crownLife(drop.mm), begins = between(time - half - drop.landing, 0, life), ends = between(time + half - drop.landing, 0, life);
      const {x, y, z} = drop, [radius, height] = crownSize((begins + ends) / 2, drop), away = distance(x, y, z), width = 2 * radius / away * focal;
      if (!(ends > begins && width > SMALLEST_PX && away < SPLASH_REACH)) return;
      const share = (ends - begins) / settings.exposure, near = width > 2 * RING_PX, upwards = height / Math.sqrt(12), middle = z + height / 2;
      const across = near ? Math.PI * radius / SEGMENTS / Math.sqrt(3) : radius / Math.sqrt(2);
      const alpha = share * COVERAGE * 2 * radius * height / (near ? SEGMENTS : 1) / (2 * Math.PI * across * upwards);
      if (!near) this._addUpright(rows, camera, [x, y, middle], across, upwards, alpha);
      else for (let k = 0; k < SEGMENTS; ++k) {
        const turn = 2 * Math.PI * k / SEGMENTS;
        this._addUpright(rows, camera, [x + radius * Math.cos(turn), y + radius * Math.sin(turn), middle], across, upwards, alpha);
      }
    });
    this._landed(time, camera, FLIGHT, Math.min(SPLASH_REACH, 1e-3 * focal / SMALLEST_PX), drop => {
      for (let number = 0; number < DROPLETS; ++number) this._addDroplet(rows, time, drop, number, eye, distance, focal);
    });
  }

  // A Gaussian that stands upright, blurred by the camera's motion along the ground and by its lens.
  _addUpright(rows, camera, place, across, upwards, alpha) {
    const {exposure} = this.settings, {aperture, focus} = rows.shutter, [vx, vy, vz] = camera.velocity, {axes} = camera;
    const away = place.map((each, k) => each - camera.position[k]), center = axes.map(axis => axis[0] * away[0] + axis[1] * away[1] + axis[2] * away[2]);
    const along = Math.hypot(across, Math.hypot(vx, vy, vz) * exposure / Math.sqrt(12));
    const circle = aperture > 0 ? aperture * Math.abs(1 - Math.max(center[2], 0) / focus) / 4 : 0;
    const [first, second, third] = [along, across, upwards].map(each => Math.hypot(each, circle));
    const opacity = between(alpha * across * upwards / Math.sqrt(first * second) / third, 0, 1), heading = Math.atan2(vy, vx);
    const side = axes.map(axis => axis[0] * Math.cos(heading) + axis[1] * Math.sin(heading));
    rows.add(...center, opacity, axes.map(axis => axis[2]), third, second, side.map(each => first * each), true);
  }

  _addDroplet(rows, time, drop, number, eye, distance, focal) {
    const {x, y, z, mm, speed, film} = drop;
    if (!(number < 7.84e-6 * splashNumber(mm, speed) ** 1.8 * between(film / mm, 0.1, 1) ** -0.3)) return;
    hash(drop.own, number, 0, 1);
    const [size, fast, rise, turn] = [hashX, hashY, hashZ, hashW].map(each => each * WHOLE), diameter = mm * (0.08 + 0.2 * size ** 3);
    const azimuth = GOLDEN * number + 2 * Math.PI * turn / DROPLETS, up = (45 + 30 * rise) * Math.PI / 180, start = (0.2 + 0.3 * fast) * speed;
    const leaves = 0.3 * crownLife(mm), [radius, height] = crownSize(leaves, drop), age = time - drop.landing - leaves;
    if (!(age > 0)) return;
    const slowing = 4 * diameter / GRAVITY, kept = Math.exp(-age / slowing), falls = GRAVITY * slowing, upward = start * Math.sin(up);
    const out = radius + start * Math.cos(up) * slowing * (1 - kept), away = start * Math.cos(up) * kept;
    const px = x + out * Math.cos(azimuth), py = y + out * Math.sin(azimuth), pz = z + height + (upward + falls) * slowing * (1 - kept) - falls * age;
    if (!(pz > z && 1e-3 * diameter * focal > SMALLEST_PX * distance(px, py, pz))) return;
    rows.addDrop(px - eye[0], py - eye[1], pz - eye[2], [away * Math.cos(azimuth), away * Math.sin(azimuth), (upward + falls) * kept - falls], diameter, true);
  }
}
