"use strict";
// Rain of the page: where each drop is at a time, and the Gaussians of its streak. The same integers and the same formulas as in
// gsrain_engine/rain (drop_field.py, air.py, streaks.py, medium.py), which have the sources; lengths in meters, times in seconds.
// Runs in a worker, without a document.

const CLASSES = 16384, CELLS = 4096, NODES = 256, ROW = NODES + 1, STEPS = 64;
const FIRST_OF_CLASS = 13125;  // inverse of the stride 10125 modulo CLASSES
const float = Math.fround;
const FRACTION = float(2 ** -24), BELOW_ONE = float(1 - 2 ** -24);
const SINE = [-1 / 6, 1 / 120, -1 / 5040].map(float), COSINE = [-1 / 2, 1 / 24, -1 / 720, 1 / 40320].map(float);
const GUST_SPEED = 2, GUST_LENGTH = 36, MIN_PERIODS = 2.25, DRIFT_HEIGHT = 3, WIND_HEIGHT = 10;
const RATES = [7, 11.3, 18.1].map(period => 2 * Math.PI / period), WAVENUMBERS = RATES.map(rate => rate / GUST_SPEED);
const GRAVITY = 9.81, EDDY_LENGTH = 3, OWN_STEPS = 147.8, MIN_FALL = 0.05;
const STREAK_REACH = 2, MAX_STRETCH = 2, NEAREST_STREAK = 0.2;
const STREAK_FLOATS = 12;  // of a streak Gaussian, in the camera's frame: center, opacity; direction, sigma along; sigma across,
// and, where it differs in the third direction, that one times its sigma
const BEFORE_GROUND = 0.75, MOST_BEFORE_GROUND = 0.15;  // by which splashes are moved towards the camera, and largest share

// Four random words of four words (pcg4d: Jarzynski and Olano 2020).
let hashX = 0, hashY = 0, hashZ = 0, hashW = 0;
function hash(x, y, z, w) {
  x = (Math.imul(x, 1664525) + 1013904223) | 0;
  y = (Math.imul(y, 1664525) + 1013904223) | 0;
  z = (Math.imul(z, 1664525) + 1013904223) | 0;
  w = (Math.imul(w, 1664525) + 1013904223) | 0;
  x = (x + Math.imul(y, w)) | 0; y = (y + Math.imul(z, x)) | 0;
  z = (z + Math.imul(x, y)) | 0; w = (w + Math.imul(y, z)) | 0;
  x ^= x >>> 16; y ^= y >>> 16; z ^= z >>> 16; w ^= w >>> 16;
  x = (x + Math.imul(y, w)) | 0; y = (y + Math.imul(z, x)) | 0; z = (z + Math.imul(x, y)) | 0;
  w = (w + Math.imul(y, z)) | 0;
  hashX = x >>> 0; hashY = y >>> 0; hashZ = z >>> 0; hashW = w >>> 0;
}

function ownSteps(drawn) {  // sum of four bytes, less its mean
  const pairs = (drawn & 0x00FF00FF) + ((drawn >>> 8) & 0x00FF00FF);
  return (pairs & 0xFFFF) + (pairs >>> 16) - 510;
}

// Mean wind relative to that at 10 m: the logarithmic law; and its integral over height from DRIFT_HEIGHT on.
function profile(height, roughness) {
  return Math.log(Math.max(height, roughness) / roughness) / Math.log(WIND_HEIGHT / roughness);
}
function profileIntegral(height, roughness) {
  const antiderivative = each => {
    const z = Math.max(each, roughness);
    return (z * Math.log(z / roughness) - z) / Math.log(WIND_HEIGHT / roughness);
  };
  return antiderivative(height) - antiderivative(DRIFT_HEIGHT);
}

// Offsets and velocities of drops in the air of one moment, as `Wind.air`: ten rows over the height of the cell, one after the
// other, and numbers.
function airAt(wind, time, drift, center, period, ground) {
  const rows = new Float32Array(10 * ROW), numbers = new Float32Array(6);
  const low = center[2] - period[2] / 2 - ground, alongX = 2 * Math.PI / Math.max(GUST_LENGTH, MIN_PERIODS * period[0]);
  const share = profile(DRIFT_HEIGHT, wind.roughness);
  for (let node = 0; node <= NODES; ++node) {
    const height = low + period[2] / NODES * node;
    const below = profileIntegral(height, wind.roughness) - share * (height - DRIFT_HEIGHT);
    const faster = profile(height, wind.roughness);
    rows[node] = -wind.mean[0] * below; rows[ROW + node] = -wind.mean[1] * below;
    rows[5 * ROW + node] = wind.mean[0] * faster; rows[6 * ROW + node] = wind.mean[1] * faster;
    const sums = [0, 0, 0, 0, 0, 0];
    for (let mode = 0; mode < 3; ++mode) {
      const reach = -wind.gust / (3 * WAVENUMBERS[mode]), peak = wind.gust / 3;
      const x = wind.phases[0][mode] - RATES[mode] * time + WAVENUMBERS[mode] * height;
      const y = wind.phases[1][mode] - RATES[mode] * time + alongX * (center[0] - drift[0]) + WAVENUMBERS[mode] * height;
      sums[0] += reach * Math.sin(x); sums[1] += reach * Math.cos(y); sums[2] += reach * Math.sin(y);
      sums[3] += peak * Math.cos(x); sums[4] += peak * Math.cos(y); sums[5] -= peak * Math.sin(y);
    }
    [2, 3, 4, 7, 8, 9].forEach((row, k) => { rows[row * ROW + node] = sums[k]; });
  }
  numbers.set([low, period[2], alongX, period[0], 1 / period[0], wind.mean[0] * share]);
  return {rows, numbers};
}

// How far drops have moved from the middle of the cell: whole periods, and the rest in 2^-32 of a period.
function split(displacement, center, period) {
  const periods = (displacement - center) / period + 0.5, whole = Math.floor(periods);
  return [whole >>> 0, Math.floor((periods - whole) * 2 ** 32) >>> 0];
}

// Fall speed over the diameter (mm): a quadratic up to its vertex (paper, eq. 9), or that of Atlas et al. 1973.
function fallSpeed({quadratic, share}, diameter) {
  if (!quadratic) return share * Math.max(9.65 - 10.3 * Math.exp(-0.6 * diameter), 0);
  const [a, b, c] = quadratic, d = a < 0 ? Math.min(diameter, -b / (2 * a)) : diameter;
  return share * ((a * d + b) * d + c);
}

// Diameters (mm) of the classes: quantiles of a gamma law between two bounds, as `DropSizes`. `logarithm` is that of what the
// density is divided by. Sums the density over a grid (Gauss-Legendre, three points), and finds each quantile in its cell (Newton).
function classDiameters({shape, scale, logarithm, smallest, largest}) {
  const density = d => Math.exp((shape - 1) * Math.log(d / scale) - d / scale - logarithm), part = Math.sqrt(3 / 5) / 2;
  const between = (a, b) => (b - a) / 18 *
    (5 * density((a + b) / 2 - part * (b - a)) + 8 * density((a + b) / 2) + 5 * density((a + b) / 2 + part * (b - a)));
  const node = k => smallest + (largest - smallest) * k / CELLS, sums = new Float64Array(CELLS + 1);
  for (let k = 0; k < CELLS; ++k) sums[k + 1] = sums[k] + between(node(k), node(k + 1));
  let cell = 0;
  return Float64Array.from({length: CLASSES}, (_, c) => {
    const sought = (c + 0.5) / CLASSES;
    while (cell < CELLS - 1 && sums[cell + 1] < sought) ++cell;
    const low = node(cell), high = node(cell + 1);
    let found = low + (high - low) * (sought - sums[cell]) / (sums[cell + 1] - sums[cell]);
    for (let k = 0; k < 4; ++k)
      found = Math.min(Math.max(found + (sought - sums[cell] - between(low, found)) / density(found), low), high);
    return found;
  });
}

// A rain at one intensity. `settings` are those of the page; `state` those of the intensity.
class Rain {
  constructor(settings, state) {
    Object.assign(this, {settings, state, diameters: classDiameters(state.sizes)});
    const slow = this.slow = new Float32Array(CLASSES), gusty = this.gusty = new Float32Array(CLASSES);
    const own = this.own = new Float32Array(CLASSES);
    this.speeds = this.diameters.map(diameter => fallSpeed(settings.fallSpeed, diameter));
    this.speeds.forEach((speed, k) => {
      const slowness = 1 / Math.max(speed, MIN_FALL), fall = 1 / slowness;
      const follows = 1 / Math.sqrt(1 + fall * fall / (GRAVITY * EDDY_LENGTH));
      slow[k] = slowness;
      gusty[k] = slowness / (1 + GUST_SPEED * slowness);
      own[k] = -slowness * (settings.wind.turbulence / OWN_STEPS) * follows;
    });
  }

  // Cell of the lattice around a camera at a time. `camera`: position, axes (right, down, forward), fx fy cx cy, size, velocity.
  _cell(time, camera) {
    const {region, wind} = this.settings, forward = camera.axes[2], length = Math.hypot(forward[0], forward[1]);
    const [x, y] = length > 1e-6 ? [forward[0] / length, forward[1] / length] : [1, 0];
    const size = [0, 1, 2].map(k => region.maximum[k] - region.minimum[k]);
    const middle = [0, 1, 2].map(k => (region.maximum[k] + region.minimum[k]) / 2);
    const turned = [x * middle[0] - y * middle[1], y * middle[0] + x * middle[1], middle[2]];
    const center = turned.map((each, k) => each + camera.position[k]);
    const period = [Math.hypot(size[0], size[1]), Math.hypot(size[0], size[1]), size[2]];
    const ground = this.settings.ground ?? camera.position[2] + region.minimum[2];
    const share = profile(DRIFT_HEIGHT, wind.roughness), drift = wind.mean.map(each => each * share * time);
    const across = [0, 1].map(k => split(drift[k], center[k], period[k]));
    const fallen = new Uint32Array(2 * CLASSES);
    this.speeds.forEach((speed, c) => fallen.set(split(-speed * time, center[2], period[2]), 2 * c));
    const count = Math.round(this.state.density * period[0] * period[1] * period[2]);
    return {center, period, size, heading: [x, y], across, fallen, count, air: airAt(wind, time, drift, center, period, ground)};
  }

  // Calls `use(number, class, x, y, z, velocity)` for each drop that may be in view, with its place from the middle of the cell.
  // As `_mark_class`: the first tests, of height and of x before gusts, leave out most.
  _visible(cell, camera, use) {
    const {seed, roofs} = this.settings, {period, size, heading, across, fallen, count, air} = cell, {rows, numbers} = air;
    const [eyeX, eyeY, eyeZ] = camera.position.map((each, k) => each - cell.center[k]), [right, down, ahead] = camera.axes;
    const [periodX, periodY, periodZ] = period, [halfX, halfY, halfZ] = size.map(each => each / 2), [turnX, turnY] = heading;
    const [[wrapsX, movedX], [, movedY]] = across, [low, tall, alongX, span, perPeriod, driftX] = numbers;
    const left = -camera.cx / camera.fx, rightmost = (camera.width - camera.cx) / camera.fx;
    const top = -camera.cy / camera.fy, bottom = (camera.height - camera.cy) / camera.fy;
    const shutter = this._shutter(camera), half = 2 ** -32, velocity = [0, 0, 0];
    const largest = row => rows.subarray(row * ROW, row * ROW + ROW).reduce((found, each) => Math.max(found, Math.abs(each)), 0);
    const reaches = [largest(0), largest(2)];
    const fastest = Math.hypot(largest(5), largest(6)) + 1.5 * (largest(7) + largest(8) + largest(9));
    const bounds = axis => {  // lowest and highest coordinate of the view, for each meter of depth
      const [r, d, a] = [right[axis], down[axis], ahead[axis]];
      return [Math.min(r * left, r * rightmost) + Math.min(d * top, d * bottom) + a,
              Math.max(r * left, r * rightmost) + Math.max(d * top, d * bottom) + a];
    };
    const [lowX, highX] = bounds(0), [lowZ, highZ] = bounds(2);
    const at = (row, node, part) => {
      const before = rows[row * ROW + node];
      return float(before + float(part * float(rows[row * ROW + node + 1] - before)));
    };
    for (let c = 0; c < CLASSES; ++c) {
      const far = shutter.far[c], first = c * FIRST_OF_CLASS % CLASSES;
      if (first >= count) continue;
      const speed = this.speeds[c];
      const reach = Math.hypot(fastest + shutter.sideways, speed + Math.abs(camera.velocity[2]));
      const margin = (STREAK_REACH * MAX_STRETCH * shutter.exposure + shutter.readout / 2) * reach + 0.02 + shutter.blur(far);
      const slow = this.slow[c], gust = this.gusty[c], own = this.own[c], ownX = own * perPeriod;
      const moved = fallen[2 * c + 1], wraps = fallen[2 * c];
      const below = Math.max(-halfZ, eyeZ + Math.min(lowZ * far, 0) - 2 * margin);
      const above = Math.min(halfZ, eyeZ + Math.max(highZ * far, 0) + 2 * margin);
      const uncertain = reaches[0] * slow + reaches[1] * gust + 0.01;
      const firstX = (eyeX + Math.min(lowX * far, 0) - 2 * margin - uncertain) / periodX + 0.5;
      const widthX = (Math.max(highX * far, 0) - Math.min(lowX * far, 0) + 4 * margin + 2 * uncertain) / periodX;
      for (let i = first; i < count; i += CLASSES) {
        hash(i, 0, 0, seed);
        const startZ = hashZ, z = (startZ + moved) >>> 0, placeZ = (z * half - 0.5) * periodZ;
        if (placeZ < below || placeZ > above) continue;
        const wrapZ = (wraps + (z < startZ ? 1 : 0)) >>> 0;
        hash(i, wrapZ, 1, seed);
        const startX = hashX, stepsX = ownSteps(hashY), stepsY = ownSteps(hashZ);
        const height = float(low + float(float((z >>> 8) * FRACTION) * tall));
        const latticeX = (startX + movedX) >>> 0;
        const about = latticeX * half + stepsX * ownX * height - firstX;
        if (about - Math.floor(about) > widthX) continue;
        const node = z >>> 24, part = float((z & 0xFFFFFF) * FRACTION);
        const along = float(float(at(0, node, part) * slow) + float(at(2, node, part) * gust));
        const offsetX = float(float(along + float(float(stepsX * own) * height)) * perPeriod), wholeX = Math.floor(offsetX);
        const partX = (Math.trunc(Math.min(float(offsetX - wholeX), BELOW_ONE) * 2 ** 24) << 8) >>> 0;
        const x = (latticeX + partX) >>> 0, placeX = (x * half - 0.5) * periodX;
        const wrapX = (wrapsX + (latticeX < startX ? 1 : 0) + (x < partX ? 1 : 0) + wholeX) >>> 0;
        hash(i, wrapZ, (wrapX * 2 + 2) >>> 0, seed);
        const turn = float(float(float(float((x >>> 8) * FRACTION) - 0.5) * span) * alongX), square = float(turn * turn);
        const sine = float(turn * float(1 + float(square * float(SINE[0] + float(square * float(SINE[1] + float(square * SINE[2])))))));
        const cosine = float(1 + float(square * float(COSINE[0] + float(square * float(COSINE[1] +
          float(square * float(COSINE[2] + float(square * COSINE[3]))))))));
        const gusts = float(float(float(at(3, node, part) * sine) + float(at(4, node, part) * cosine)) * gust);
        const acrossY = float(float(at(1, node, part) * slow) + gusts);
        const offsetY = float(float(acrossY + float(float(stepsY * own) * height)) * perPeriod);
        const partY = (Math.trunc(Math.min(float(offsetY - Math.floor(offsetY)), BELOW_ONE) * 2 ** 24) << 8) >>> 0;
        const y = (hashY + movedY + partY) >>> 0, placeY = (y * half - 0.5) * periodY;
        if (Math.abs(turnX * placeX + turnY * placeY) > halfX || Math.abs(turnX * placeY - turnY * placeX) > halfY) continue;
        if (Math.abs(placeZ) > halfZ) continue;
        const dx = placeX - eyeX, dy = placeY - eyeY, dz = placeZ - eyeZ;
        const depth = ahead[0] * dx + ahead[1] * dy + ahead[2] * dz;
        if (depth < 0 || depth > far) continue;
        const u = right[0] * dx + right[1] * dy + right[2] * dz, v = down[0] * dx + down[1] * dy + down[2] * dz;
        if (u < left * depth - margin || u > rightmost * depth + margin) continue;
        if (v < top * depth - margin || v > bottom * depth + margin) continue;
        if (roofs && this._isSheltered(placeX + cell.center[0], placeY + cell.center[1], placeZ + cell.center[2])) continue;
        const perStep = slow > 0 ? -own / slow : 0;
        velocity[0] = at(5, node, part) + at(7, node, part) + perStep * stepsX;
        const carried = (velocity[0] - driftX) * alongX * gust * (at(3, node, part) * cosine - at(4, node, part) * sine);
        velocity[1] = at(6, node, part) + at(8, node, part) * cosine + at(9, node, part) * sine + carried + perStep * stepsY;
        velocity[2] = -speed;
        use(i, c, placeX, placeY, placeZ, velocity);
      }
    }
  }

  _isSheltered(x, y, z) {
    const {heights, rows, columns, corner, cell} = this.settings.roofs;
    const column = Math.floor((x - corner[0]) / cell), row = Math.floor((y - corner[1]) / cell);
    return column >= 0 && column < columns && row >= 0 && row < rows && z < heights[row * columns + column];
  }

  // Exposure, lens and rolling shutter of a camera, and the view depth from which the medium represents the drops of a class.
  _shutter(camera) {
    const {sensor, exposure, criticalHaze, wind} = this.settings, focal = Math.sqrt(camera.fx * camera.fy);
    let aperture = 0, focus = 10;
    if (sensor.fNumber) {
      const native = camera.fy * sensor.rows / camera.height;
      aperture = native * 1e-6 * sensor.pitch / sensor.fNumber;
      focus = sensor.focus || aperture * native;
    }
    const far = this.diameters.map(diameter => criticalHaze * focal * diameter * 1e-3);
    const farthest = Math.hypot(...this.settings.region.maximum.map((each, k) => each - this.settings.region.minimum[k]));
    const blur = depth => 5 / 4 * aperture * Math.max(1, Math.abs(1 - Math.min(depth, farthest) / focus));
    const sideways = 5 * wind.turbulence + Math.hypot(camera.velocity[0], camera.velocity[1]);
    return {exposure, focal, aperture, focus, far, blur, sideways, readout: sensor.readout,
            scan: [camera.fy / camera.height, camera.cy / camera.height - 0.5]};
  }

  // Numbers, places (world) and diameters (mm) of the drops that may be visible to a camera at a time.
  drops(time, camera) {
    const cell = this._cell(time, camera), found = [];
    this._visible(cell, camera, (number, c, x, y, z) =>
      found.push([number, x + cell.center[0], y + cell.center[1], z + cell.center[2], this.diameters[c]]));
    return found;
  }

  // Gaussians of streaks and splashes in the camera's frame, `STREAK_FLOATS` each.
  streaks(time, camera) {
    const cell = this._cell(time, camera), rows = new StreakRows(this.settings, this._shutter(camera), camera);
    const [eyeX, eyeY, eyeZ] = camera.position.map((each, k) => each - cell.center[k]);
    this._visible(cell, camera, (number, c, x, y, z, moves) => rows.addDrop(x - eyeX, y - eyeY, z - eyeZ, moves, this.diameters[c]));
    if (this.splashes) this.splashes.add(rows, time, camera);
    return rows.all;
  }

  // Numbers, table and floor of the medium for a camera, as `RainMedium`.
  medium(camera) {
    const cell = {size: [0, 1, 2].map(k => this.settings.region.maximum[k] - this.settings.region.minimum[k])};
    const shutter = this._shutter(camera), {diameters} = this, {density} = this.state, {region, hazeGain} = this.settings;
    const reach = Math.min(Math.hypot(...cell.size), shutter.far[CLASSES - 1]), step = reach / (STEPS - 1);
    const areas = new Float64Array(CLASSES + 1);  // of the drops of a class and of larger ones (m2), for each drop
    for (let c = CLASSES - 1; c >= 0; --c) areas[c] = areas[c + 1] + Math.PI / 4 * (1e-3 * diameters[c]) ** 2;
    const fine = 16 * STEPS, total = new Float64Array(fine + 1);
    let c = 0, before = 0;
    for (let k = 0; k <= fine; ++k) {
      const depth = reach * k / fine;
      while (c < CLASSES && shutter.far[c] < depth) ++c;
      const now = depth >= NEAREST_STREAK ? hazeGain * density * areas[c] / CLASSES : 0;
      total[k] = k ? total[k - 1] + 0.5 * (before + now) * reach / fine : 0;
      before = now;
    }
    const drawn = Float32Array.from({length: STEPS}, (_, k) => {
      const at = Math.min(k * fine / (STEPS - 1), fine - 1e-9), low = Math.floor(at);
      return total[low] + (at - low) * (total[low + 1] - total[low]);
    });
    const forward = camera.axes[2], length = Math.hypot(forward[0], forward[1]);
    const [x, y] = length > 1e-6 ? [forward[0] / length, forward[1] / length] : [1, 0];
    const turn = [[x, y, 0], [-y, x, 0], [0, 0, 1]], middle = [0, 1, 2].map(k => (region.maximum[k] + region.minimum[k]) / 2);
    const rotation = turn.flatMap(row => camera.axes.map(axis => row[0] * axis[0] + row[1] * axis[1] + row[2] * axis[2]));
    const box = [...rotation, ...middle.map(each => -each), ...cell.size.map(each => each / 2)];
    const over = camera.floor === null || camera.floor === undefined ? 1e9 : camera.position[2] - camera.floor;
    const floor = Float32Array.from([...camera.axes.map(axis => axis[2]), over > 0.05 && over < 1e9 ? over : 1e9]);
    return {numbers: Float32Array.from([this.state.extinction, step, ...box, ...box, 0]), drawn, floor};
  }
}

// Gaussians in a camera's frame, `STREAK_FLOATS` each.
class StreakRows {
  constructor(settings, shutter, camera) {
    Object.assign(this, {settings, shutter, camera, count: 0, rows: new Float32Array(STREAK_FLOATS * 4096), place: [0, 0, 0], velocity: [0, 0, 0]});
  }

  get all() { return this.rows.subarray(0, STREAK_FLOATS * this.count); }

  // A Gaussian; a splash is moved towards the camera and made smaller, so that the ground does not cover it.
  add(x, y, z, opacity, direction, along, across, side, isSplash) {
    if ((this.count + 1) * STREAK_FLOATS > this.rows.length) {
      const more = new Float32Array(2 * this.rows.length);
      more.set(this.rows);
      this.rows = more;
    }
    const {rows} = this, base = STREAK_FLOATS * this.count++;
    const near = isSplash ? 1 - Math.min(BEFORE_GROUND / Math.max(Math.hypot(x, y, z), 1e-6), MOST_BEFORE_GROUND) : 1;
    rows[base] = near * x; rows[base + 1] = near * y; rows[base + 2] = near * z;
    rows[base + 3] = opacity;
    rows[base + 4] = direction[0]; rows[base + 5] = direction[1]; rows[base + 6] = direction[2];
    rows[base + 7] = near * along;
    rows[base + 8] = near * across;
    if (side) for (let k = 0; k < 3; ++k) rows[base + 9 + k] = near * side[k];
  }

  // The streak of a drop at a place (world, from the camera) that moves (m/s) and has a diameter in mm.
  addDrop(x, y, z, [moveX, moveY, moveZ], millimeters, isSplash = false) {
    const {settings, place: p, velocity: v} = this, {exposure, focal, aperture, focus, readout, scan} = this.shutter;
    const {axes, velocity: [ownX, ownY, ownZ]} = this.camera, vx = moveX - ownX, vy = moveY - ownY, vz = moveZ - ownZ, across = Math.sqrt(2 * Math.PI);
    for (let k = 0; k < 3; ++k) {
      const axis = axes[k];
      p[k] = axis[0] * x + axis[1] * y + axis[2] * z;
      v[k] = axis[0] * vx + axis[1] * vy + axis[2] * vz;
    }
    const diameter = 1e-3 * millimeters;
    let stretch = 1;
    if (readout > 0 && p[2] > 0) {
      const slope = p[1] / p[2], rate = scan[0] * (v[1] - slope * v[2]) / p[2];
      stretch = 1 / Math.max(1 - readout * rate, 1 / MAX_STRETCH);
      const later = Math.min(Math.max(readout * stretch * (scan[0] * slope + scan[1]), -readout), readout);
      for (let k = 0; k < 3; ++k) p[k] += later * v[k];
    }
    const distance = Math.max(Math.hypot(p[0], p[1], p[2]), 1e-9), speed = Math.hypot(v[0], v[1], v[2]);
    const along = (v[0] * p[0] + v[1] * p[1] + v[2] * p[2]) / distance;
    const sideways = Math.sqrt(Math.max(speed * speed - along * along, 0)), limit = focal * diameter;
    let alpha = Math.min(1, diameter / Math.max(sideways * exposure, 1e-12)) * Math.min(1, limit / Math.max(p[2], 1e-9));
    if (p[2] > settings.criticalHaze * limit) alpha = settings.hazeOpacity;
    alpha = Math.min(1, settings.streakGain * alpha);
    let opacity = 1 - (1 - alpha) ** (1 / across);
    const length = speed * exposure * stretch, ratio = millimeters > 1 ? -0.07 * millimeters + 1.07 : 1;
    const copies = Math.min(Math.max(Math.round(length / (ratio * diameter)), 1), settings.maxCopies);
    let sigma = Math.sqrt(Math.PI / 32) * Math.max(diameter, p[2] / focal) * (alpha / Math.max(across * opacity, 1e-30));
    let sigmaAlong = Math.max(length / copies, sigma);
    if (aperture > 0) {
      const blur = aperture * Math.abs(1 - p[2] / focus) / 4, sine = sideways / Math.max(speed, 1e-9);
      const apparent = Math.hypot(sigmaAlong * sine, sigma * Math.sqrt(Math.max(1 - sine * sine, 0)));
      opacity *= sigma / Math.hypot(sigma, blur) * apparent / Math.hypot(apparent, blur);
      sigma = Math.hypot(sigma, blur);
      sigmaAlong = Math.hypot(sigmaAlong, blur);
    }
    const scale = 1 / Math.max(speed, 1e-9), direction = [scale * v[0], scale * v[1], scale * v[2]];
    for (let copy = 0; copy < copies; ++copy) {
      const offset = (copy - (copies - 1) / 2) * (length / copies);
      this.add(p[0] + offset * direction[0], p[1] + offset * direction[1], p[2] + offset * direction[2], opacity, direction, sigmaAlong, sigma, null, isSplash);
    }
  }
}

// Numbers of all Gaussians, farthest first: by two stable counting passes over 22 bits of the depth, which is positive. Of
// equal depths, the first is the nearest, as on the desktop.
// `fixed` are positions in the world, those of `streaks` follow them; what is nearer than `near` is left out. `members` are
// numbers of actors, whose positions move with their poses; 0 does not move.
class DepthOrder {
  constructor(fixed, members, mirror) {
    Object.assign(this, {fixed, members, mirror, still: fixed});
    this.resize(fixed.length / 3);
  }

  resize(room) {
    this.room = room;
    [this.keys, this.ids, this.spare] = [0, 1, 2].map(() => new Uint32Array(room));
    this.value = new Float32Array(1);
    this.bits = new Uint32Array(this.value.buffer);
  }

  // Moves actors; `poses` are in the file's frame, which `rotation` and `origin` lead to the world.
  move(poses, rotation, origin) {
    const {still, members} = this, fixed = this.fixed = this.fixed === still ? still.slice() : this.fixed;
    const turn = (m, x, y, z, k) => m[k][0] * x + m[k][1] * y + m[k][2] * z;
    const back = [0, 1, 2].map(k => rotation.map(row => row[k])), local = [0, 0, 0], moved = [0, 0, 0];
    for (let i = 0; i < members.length; ++i) {
      if (!members[i]) continue;
      const base = 12 * (members[i] - 1), away = [0, 1, 2].map(k => still[3 * i + k] - origin[k]);
      for (let k = 0; k < 3; ++k) local[k] = turn(back, ...away, k);
      for (let k = 0; k < 3; ++k)
        moved[k] = poses[base + 4 * k] * local[0] + poses[base + 4 * k + 1] * local[1] + poses[base + 4 * k + 2] * local[2] + poses[base + 4 * k + 3];
      for (let k = 0; k < 3; ++k) fixed[3 * i + k] = turn(rotation, ...moved, k) + origin[k];
    }
  }

  // With `level`, their numbers among those that a mirror shows only, over level ground: its height, and the heights below actors.
  of(camera, streaks, near, level = null) {
    const {fixed, value, bits, members} = this, count = fixed.length / 3, more = streaks.length / STREAK_FLOATS;
    const {reflected, floors} = level ? this.mirror : {reflected: null, floors: null}, all = reflected ? reflected.length : count;
    if (count + more > this.room) this.resize(count + 2 * more);
    const {keys, ids, spare} = this, [x, y, z] = camera.axes[2];
    const constant = -(x * camera.position[0] + y * camera.position[1] + z * camera.position[2]);
    value[0] = near;
    const first = bits[0];
    let n = 0;
    for (let j = all - 1; j >= 0; --j) {
      const i = reflected ? reflected[j] : j, k = 3 * i;
      let depth = x * fixed[k] + y * fixed[k + 1] + z * fixed[k + 2] + constant;
      if (floors) depth += z * (level.ground - (members && members[i] ? level.actors[members[i] - 1] : floors[i]));
      if (!(depth > near)) continue;
      value[0] = depth;
      keys[j] = 0x3FFFFF - Math.min((bits[0] - first) >>> 6, 0x3FFFFF);
      ids[n++] = j;
    }
    for (let i = 0; i < more; ++i) {
      const depth = streaks[STREAK_FLOATS * i + 2];
      if (!(depth > near)) continue;
      value[0] = depth;
      keys[count + i] = 0x3FFFFF - Math.min((bits[0] - first) >>> 6, 0x3FFFFF);
      ids[n++] = count + i;
    }
    this._pass(keys, ids, spare, n, 0);
    this._pass(keys, spare, ids, n, 11);
    return ids.subarray(0, n);
  }

  _pass(keys, from, to, n, shift) {
    const starts = new Uint32Array(2049);
    for (let k = 0; k < n; ++k) ++starts[((keys[from[k]] >>> shift) & 2047) + 1];
    for (let k = 0; k < 2048; ++k) starts[k + 1] += starts[k];
    for (let k = 0; k < n; ++k) to[starts[(keys[from[k]] >>> shift) & 2047]++] = from[k];
  }
}

// The worker: answers each camera, time and state of the rain with streaks, the medium and the order of all Gaussians.
if (typeof WorkerGlobalScope !== "undefined" && self instanceof WorkerGlobalScope) {
  let order = null, rains = [];
  self.onmessage = ({data}) => {
    if (data.fixed) {
      order = new DepthOrder(data.fixed, data.members, data.mirror);
      rains = data.states.map(state => new Rain(data.settings, state));
      rains.forEach((rain, k) => {
        if (rain.state.splashes) rain.splashes = new Splashes(rain, data.impacts.subarray(2 * KNOTS * k, 2 * KNOTS * (k + 1)), data.ground);
      });
      return;
    }
    const {camera, time, state, near} = data, rain = rains[state];
    if (data.drops) {
      self.postMessage({id: data.id, drops: rain.drops(time, camera)});
      return;
    }
    const falls = rain.state.density > 0 || rain.splashes, streaks = falls ? rain.streaks(time, camera) : new Float32Array(0);
    if (data.poses) order.move(data.poses, data.rotation, data.origin);
    const ids = order.of(camera, streaks, near).slice(), copy = streaks.slice(), {mirror, floors} = data;
    const reflected = mirror && order.of(mirror.below, new Float32Array(0), near, {ground: mirror.ground, actors: floors}).slice();
    const {numbers, drawn, floor} = rain.medium(camera);
    self.postMessage({id: data.id, ids, streaks: copy, numbers, drawn, floor, camera, state, reflected, floors, poses: data.poses}, [ids.buffer, copy.buffer]);
  };
} else if (typeof module !== "undefined") {
  module.exports = {Rain, DepthOrder, classDiameters};
}
