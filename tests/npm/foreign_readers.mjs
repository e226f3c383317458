// Reads and writes scene files with programs of others: node foreign_readers.mjs JOBS, where JOBS is JSON with lists of
//   convert: [from, to] by splat-transform (PlayCanvas);
//   ksplat: [from, to], a .ksplat as numbers in JSON, or a .ply as a .ksplat of level 1, by GaussianSplats3D (mkkellogg);
//   validate: a .glb by Khronos' validator.
// Prints JSON: the messages of `validate`, a list for each file.
import fs from "node:fs";
import {createRequire} from "node:module";

console.log = console.error;  // what libraries print is not the answer
const {convert = [], ksplat = [], validate = []} = JSON.parse(process.argv[2]);
const bytes = file => new Uint8Array(fs.readFileSync(file));

async function converted(from, to) {
  const {MemoryReadFileSystem, MemoryFileSystem, WebPCodec, getInputFormat, getOutputFormat, readFile, writeFile} = await import("@playcanvas/splat-transform");
  const require = createRequire(import.meta.url);
  WebPCodec.wasmUrl = require.resolve("@playcanvas/splat-transform/lib/webp.wasm");
  const fileSystem = new MemoryReadFileSystem(), written = new MemoryFileSystem();
  fileSystem.set(from, bytes(from));
  const options = {iterations: 1}, [dataTable] = await readFile({filename: from, inputFormat: getInputFormat(from), options, params: [], fileSystem});
  await writeFile({filename: to, outputFormat: getOutputFormat(to, options), dataTable, options}, written);
  for (const [name, content] of written.results) fs.writeFileSync(name, content);
}

async function throughKsplat(from, to) {
  globalThis.window = globalThis;  // GaussianSplats3D is made for browsers; splat-transform must not find it
  const {KSplatLoader, PlyLoader} = await import("@mkkellogg/gaussian-splats-3d"), THREE = await import("three");
  const data = bytes(from).buffer;
  if (from.endsWith(".ply")) {
    const made = await PlyLoader.loadFromFileData(data, 0, 1, true, 2);
    fs.writeFileSync(to, new Uint8Array(made.bufferData));
    return;
  }
  const read = await KSplatLoader.loadFromFileData(data), n = read.getSplatCount(), degree = read.getMinSphericalHarmonicsDegree();
  const scale = new THREE.Vector3(), turn = new THREE.Quaternion(), mean = new THREE.Vector3(), color = new THREE.Vector4();
  const harmonics = new Float32Array(n * [0, 9, 24][degree]);
  if (degree) read.fillSphericalHarmonicsArray(harmonics, degree, undefined, 0, n - 1, 0, 0);
  const rows = Array.from({length: n}, (_, i) => {
    read.getSplatCenter(i, mean);
    read.getSplatScaleAndRotation(i, scale, turn);
    read.getSplatColor(i, color);
    return [...mean, ...scale, turn.w, turn.x, turn.y, turn.z, ...color];
  });
  fs.writeFileSync(to, JSON.stringify({rows, harmonics: Array.from(harmonics)}));
}

async function messages(file) {
  const {default: validator} = await import("gltf-validator");
  const {issues} = await validator.validateBytes(bytes(file), {maxIssues: 1000});
  return issues.messages.map(({code, message, pointer, severity}) => ({code, message, pointer, severity}));
}

for (const [from, to] of convert) await converted(from, to);
for (const [from, to] of ksplat) await throughKsplat(from, to);
const found = [];
for (const file of validate) found.push(await messages(file));
process.stdout.write(JSON.stringify(found));
