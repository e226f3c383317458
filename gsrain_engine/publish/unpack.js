"use strict";
// What a page holds, out of its text: base 85, then a zip file.

// Bytes of a text that has five characters for each four (`base85` in page.py).
function bytesOf(text) {
  const values = new Uint8Array(128), rows = Math.ceil(text.length / 5), bytes = new Uint8Array(4 * rows), view = new DataView(bytes.buffer);
  [..."0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;,=>?@^_`{|}~"].forEach((letter, k) => { values[letter.charCodeAt(0)] = k; });
  const padded = text.padEnd(5 * rows, "~"), digit = at => values[padded.charCodeAt(at)];
  for (let k = 0, at = 0; k < rows; ++k, at += 5)
    view.setUint32(4 * k, (((digit(at) * 85 + digit(at + 1)) * 85 + digit(at + 2)) * 85 + digit(at + 3)) * 85 + digit(at + 4));
  return bytes.subarray(0, Math.floor(text.length * 4 / 5));
}

// Files of a zip archive, stored or deflated.
async function unzipped(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength), files = {};
  let end = bytes.length - 22;
  while (end > 0 && view.getUint32(end, true) !== 0x06054b50) --end;
  let at = view.getUint32(end + 16, true);
  for (let left = view.getUint16(end + 10, true); left > 0; --left) {
    const method = view.getUint16(at + 10, true), size = view.getUint32(at + 20, true), local = view.getUint32(at + 42, true);
    const name = new TextDecoder().decode(bytes.subarray(at + 46, at + 46 + view.getUint16(at + 28, true)));
    const start = local + 30 + view.getUint16(local + 26, true) + view.getUint16(local + 28, true);
    const data = bytes.subarray(start, start + size);
    files[name] = method === 0 ? data : new Uint8Array(await new Response(
      new Blob([data]).stream().pipeThrough(new DecompressionStream("deflate-raw"))).arrayBuffer());
    at += 46 + view.getUint16(at + 28, true) + view.getUint16(at + 30, true) + view.getUint16(at + 32, true);
  }
  return files;
}
