// Vectors, matrices (by columns, as WebGL wants them), colours, normals, an arrow.

const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => scaled(a, 1 / (Math.hypot(...a) || 1));

function multiply(a, b) {
  const out = new Float32Array(16);
  for (let i = 0; i < 4; i++) {
    for (let j = 0; j < 4; j++) {
      for (let k = 0; k < 4; k++) out[4 * j + i] += a[4 * k + i] * b[4 * j + k];
    }
  }
  return out;
}

const transform = (m, p) => [0, 1, 2, 3].map((i) => m[i] * p[0] + m[4 + i] * p[1] + m[8 + i] * p[2] + m[12 + i]);

// Rows of the turns that bring the axis that points up to y; the same as touchnet.reconstruction's.
const TO_Y_UP = {
  x: [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
  y: [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
  z: [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
};

const turned = (up, p) => TO_Y_UP[up].map((row) => dot(row, p));
const turnedBack = (up, p) => [0, 1, 2].map((i) => TO_Y_UP[up].reduce((sum, row, k) => sum + row[i] * p[k], 0));

function viewMatrix(right, above, towards, eye) {
  return new Float32Array([
    right[0], above[0], towards[0], 0,
    right[1], above[1], towards[1], 0,
    right[2], above[2], towards[2], 0,
    -dot(right, eye), -dot(above, eye), -dot(towards, eye), 1,
  ]);
}

function perspective(angle, aspect, near, far) {
  const f = 1 / Math.tan(angle / 2);
  const out = new Float32Array(16);
  out[0] = f / Math.max(aspect, 1e-6);
  out[5] = f;
  out[10] = (far + near) / (near - far);
  out[11] = -1;
  out[14] = (2 * far * near) / (near - far);
  return out;
}

// CSS colour "#rrggbb" to linear red, green, blue.
function linear(hex) {
  return [1, 3, 5].map((i) => {
    const c = parseInt(hex.slice(i, i + 2), 16) / 255;
    return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  });
}

// Björn Ottosson's OKLCH (even lightness over all hues) to linear red, green, blue.
function oklch(lightness, chroma, hue) {
  const a = chroma * Math.cos(hue);
  const b = chroma * Math.sin(hue);
  const l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (lightness - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ].map((c) => Math.min(Math.max(c, 0), 1));
}

// Steps of the golden angle: strokes that follow each other differ most, and no hue comes twice.
const strokeColour = (k) => oklch([0.66, 0.54, 0.76][k % 3], 0.17, 0.6 + k * 2.399963);

const RAMPS = {
  order: ["#440154", "#482878", "#3e4a89", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58", "#b5de2b", "#fde725"],
  confidence: ["#d9480f", "#f08c3c", "#f3c98b", "#e6e4dc", "#b9cad9", "#8fafcc", "#6690ba"],
};

function onRamp(stops, t) {
  const at = Math.min(Math.max(t, 0), 1) * (stops.length - 1);
  const k = Math.min(Math.floor(at), stops.length - 2);
  const [a, b] = [linear(stops[k]), linear(stops[k + 1])];
  return [0, 1, 2].map((i) => a[i] + (at - k) * (b[i] - a[i]));
}

// Corners of all triangles with normals: smoothed over the whole surface, or only over edges flatter than 40 degrees.
function corners(positions, faces, smooth) {
  const count = faces.length;
  const normals = new Float32Array(count); // of the faces, as long as twice their area
  const sums = new Float32Array(positions.length);
  for (let f = 0; f < count; f += 3) {
    const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]];
    const [ux, uy, uz] = [0, 1, 2].map((i) => positions[b + i] - positions[a + i]);
    const [vx, vy, vz] = [0, 1, 2].map((i) => positions[c + i] - positions[a + i]);
    normals[f] = uy * vz - uz * vy;
    normals[f + 1] = uz * vx - ux * vz;
    normals[f + 2] = ux * vy - uy * vx;
    for (const at of [a, b, c]) for (let i = 0; i < 3; i++) sums[at + i] += normals[f + i];
  }
  const position = new Float32Array(3 * count);
  const normal = new Float32Array(3 * count);
  for (let k = 0; k < count; k++) position.set(positions.subarray(3 * faces[k], 3 * faces[k] + 3), 3 * k);
  if (smooth) {
    for (let k = 0; k < count; k++) normal.set(sums.subarray(3 * faces[k], 3 * faces[k] + 3), 3 * k);
    return { position, normal };
  }

  const start = new Uint32Array(positions.length / 3 + 1); // faces around each vertex
  for (let k = 0; k < count; k++) start[faces[k] + 1]++;
  for (let v = 1; v < start.length; v++) start[v] += start[v - 1];
  const fill = start.slice();
  const around = new Uint32Array(count);
  for (let k = 0; k < count; k++) around[fill[faces[k]]++] = k - (k % 3);
  const lengths = new Float32Array(count / 3);
  for (let f = 0; f < count; f += 3) lengths[f / 3] = Math.hypot(normals[f], normals[f + 1], normals[f + 2]);
  const flat = Math.cos((40 * Math.PI) / 180);
  for (let k = 0; k < count; k++) {
    const f = k - (k % 3);
    for (let n = start[faces[k]]; n < start[faces[k] + 1]; n++) {
      const g = around[n];
      const along = normals[f] * normals[g] + normals[f + 1] * normals[g + 1] + normals[f + 2] * normals[g + 2];
      if (along >= flat * lengths[f / 3] * lengths[g / 3]) {
        for (let i = 0; i < 3; i++) normal[3 * k + i] += normals[g + i];
      }
    }
  }
  return { position, normal };
}

// Triangles of an arrow of length 1 along +z with its tip in the origin, coming from +z; positions and normals.
function arrow() {
  const position = [];
  const normal = [];
  const [tip, neck, cone, shaft, sides] = [0, 0.36, 0.13, 0.045, 28];
  const at = (radius, angle, z) => [radius * Math.cos(angle), radius * Math.sin(angle), z];
  const push = (points, normals) => {
    for (const p of points) position.push(...p);
    for (const n of normals) normal.push(...n);
  };
  for (let k = 0; k < sides; k++) {
    const [a, b] = [k, k + 1].map((i) => (2 * Math.PI * i) / sides);
    const slope = (angle) => unit(at(neck, angle, -cone));
    const out = (angle) => at(1, angle, 0);
    const [down, upward] = [[0, 0, 1], [0, 0, 1]];
    push([at(0, a, tip), at(cone, b, neck), at(cone, a, neck)], [slope((a + b) / 2), slope(b), slope(a)]);
    push([at(0, a, neck), at(cone, a, neck), at(cone, b, neck)], [down, down, down]);
    push([at(shaft, a, neck), at(shaft, b, neck), at(shaft, b, 1)], [out(a), out(b), out(b)]);
    push([at(shaft, a, neck), at(shaft, b, 1), at(shaft, a, 1)], [out(a), out(b), out(a)]);
    push([at(0, a, 1), at(shaft, a, 1), at(shaft, b, 1)], [upward, upward, upward]);
  }
  return { position: new Float32Array(position), normal: new Float32Array(normal) };
}

// 1, 2 or 5 times a power of ten near `length`.
function niceStep(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  const digit = length / power;
  return (digit < 1.5 ? 1 : digit < 3.5 ? 2 : digit < 7.5 ? 5 : 10) * power;
}
