"use strict";

// What touchnet/viewer/scene.py packed: gzip of a length, a head in JSON, and arrays as planes of bytes.
async function unpack(compressed) {
  const stream = new Blob([compressed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const length = new DataView(bytes.buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
  const types = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, i1: Int8Array, f4: Float32Array };
  let at = 4 + length;
  for (const [name, type, shape] of head.arrays) {
    const count = shape.reduce((a, b) => a * b, 1);
    const array = new types[type](count);
    const whole = new Uint8Array(array.buffer);
    const width = array.BYTES_PER_ELEMENT;
    for (let k = 0; k < width; k++) {
      for (let i = 0; i < count; i++) whole[i * width + k] = bytes[at++];
    }
    if (type[0] === "u") {
      const row = shape[shape.length - 1];
      for (let i = 0; i < count; i++) if (i % row) array[i] += array[i - 1]; // wraps as the subtraction did
    }
    head[name] = array;
  }
  return head;
}

async function unpackInlined(element) {
  const text = atob(element.textContent);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  element.remove();
  return unpack(bytes);
}

// Positions (x, y, z, x, ...) of a step's mesh from its three rows of 16-bit numbers.
function meshPositions(step) {
  const count = step.vertices;
  const out = new Float32Array(3 * count);
  for (let axis = 0; axis < 3; axis++) {
    const scale = step.size[axis] / 65535;
    for (let i = 0; i < count; i++) out[3 * i + axis] = step.low[axis] + scale * step.vertex[axis * count + i];
  }
  return out;
}
