// Everything that touches WebGL: one mesh, balls for contacts, lines for their paths, arrows for suggestions, a floor.

const LIGHT = `
uniform vec3 u_above; // the display's up direction in the camera's axes
uniform bool u_pick;
const vec3 KEY = vec3(-0.448, 0.647, 0.617);
const vec3 FILL = vec3(0.806, 0.054, 0.590);
vec3 lit(vec3 colour, vec3 normal, float shine) {
  float sky = 0.5 + 0.5 * dot(normal, u_above);
  vec3 light = mix(vec3(0.20, 0.19, 0.18), vec3(0.42, 0.44, 0.48), sky);
  light += 0.70 * max(dot(normal, KEY), 0.0) * vec3(1.0, 0.985, 0.96) + 0.16 * max(dot(normal, FILL), 0.0);
  float glint = pow(max(dot(normal, normalize(KEY + vec3(0, 0, 1))), 0.0), 40.0);
  return colour * light + shine * glint;
}
vec4 shown(vec3 colour, float alpha) { return vec4(pow(clamp(colour, 0.0, 1.0), vec3(1.0 / 2.2)), alpha); }
vec4 named(int id) { return vec4(float(id & 255), float((id >> 8) & 255), float((id >> 16) & 255), 255.0) / 255.0; }
`;

const SHADERS = {
  mesh: [
    `in vec3 a_position; in vec3 a_normal; in vec3 a_colour;
    uniform mat4 u_view, u_projection; out vec3 v_normal, v_place, v_colour;
    void main() {
      vec4 place = u_view * vec4(a_position, 1);
      v_place = place.xyz; v_normal = mat3(u_view) * a_normal; v_colour = a_colour;
      gl_Position = u_projection * place;
    }`,
    `in vec3 v_normal, v_place, v_colour; uniform float u_opacity; out vec4 o_colour;
    void main() {
      if (u_pick) { o_colour = vec4(0, 0, 0, 1); return; }
      vec3 normal = normalize(v_normal);
      vec3 colour = v_colour;
      if (!gl_FrontFacing) { normal = -normal; if (u_opacity == 1.0) colour = vec3(0.60, 0.17, 0.12); }
      vec3 eye = normalize(-v_place);
      float rim = pow(1.0 - abs(dot(normal, eye)), 3.0);
      colour = lit(colour, normal, 0.05) + 0.05 * rim;
      // Seen edge-on, a thin wall is as dense as its outline.
      o_colour = shown(colour, u_opacity == 1.0 ? 1.0 : mix(u_opacity, 1.0, 0.7 * rim));
    }`,
  ],
  ball: [
    `in vec2 a_corner; in vec3 a_position; in vec3 a_colour;
    uniform mat4 u_view, u_projection; uniform float u_radius, u_least, u_pixel; uniform int u_first;
    out vec2 v_corner; out vec3 v_colour, v_middle; out float v_radius; flat out int v_id;
    void main() {
      vec4 middle = u_view * vec4(a_position, 1);
      v_radius = max(u_radius, u_least * u_pixel * -middle.z);
      v_corner = 1.25 * a_corner; v_colour = a_colour; v_middle = middle.xyz; v_id = u_first + gl_InstanceID;
      gl_Position = u_projection * (middle + vec4(v_corner * v_radius, 0, 0));
    }`,
    `in vec2 v_corner; in vec3 v_colour, v_middle; in float v_radius; flat in int v_id;
    uniform mat4 u_projection; out vec4 o_colour;
    void main() {
      float away = length(v_corner);
      float covered = clamp((1.0 - away) / max(fwidth(away), 1e-4) + 0.5, 0.0, 1.0);
      if (covered == 0.0) discard;
      vec3 normal = vec3(v_corner, sqrt(max(1.0 - away * away, 0.0)));
      vec4 clip = u_projection * vec4(v_middle + v_radius * normal, 1);
      gl_FragDepth = clamp(0.5 + 0.5 * clip.z / clip.w, 0.0, 1.0);
      if (u_pick) { if (away > 1.0) discard; o_colour = named(v_id); return; }
      o_colour = shown(lit(v_colour, normalize(normal + 1e-5), 0.25), covered);
    }`,
  ],
  line: [
    `in vec2 a_corner; in vec3 a_start, a_end, a_colour;
    uniform mat4 u_view, u_projection; uniform vec2 u_size; uniform float u_width, u_lift;
    out vec3 v_colour; out float v_across;
    vec4 lifted(vec3 p) { vec4 place = u_view * vec4(p, 1); place.xyz *= 1.0 - u_lift / length(place.xyz); return place; }
    void main() {
      vec4 from = u_projection * lifted(a_start), to = u_projection * lifted(a_end);
      vec2 along = (to.xy / to.w - from.xy / from.w) * u_size;
      along = length(along) > 1e-6 ? normalize(along) : vec2(1, 0);
      vec4 at = a_corner.x < 0.0 ? from : to;
      v_across = a_corner.y; v_colour = a_colour;
      at.xy += vec2(-along.y, along.x) * a_corner.y * (u_width + 1.0) / u_size * at.w;
      gl_Position = from.w > 0.0 && to.w > 0.0 ? at : vec4(2, 2, 2, 1);
    }`,
    `in vec3 v_colour; in float v_across; uniform float u_width; out vec4 o_colour;
    void main() {
      if (u_pick) discard;
      o_colour = shown(v_colour, clamp((1.0 - abs(v_across)) * 0.5 * (u_width + 1.0), 0.0, 1.0));
    }`,
  ],
  arrow: [
    `in vec3 a_position, a_normal, a_tip, a_away;
    uniform mat4 u_view, u_projection; uniform float u_length; uniform int u_first;
    out vec3 v_normal; flat out int v_id;
    void main() {
      vec3 side = normalize(abs(a_away.y) < 0.9 ? cross(vec3(0, 1, 0), a_away) : cross(vec3(1, 0, 0), a_away));
      mat3 turn = mat3(side, cross(a_away, side), a_away);
      v_normal = mat3(u_view) * turn * a_normal; v_id = u_first + gl_InstanceID;
      gl_Position = u_projection * u_view * vec4(a_tip + turn * a_position * u_length, 1);
    }`,
    `in vec3 v_normal; flat in int v_id; uniform vec3 u_colour; out vec4 o_colour;
    void main() {
      o_colour = u_pick ? named(v_id) : shown(lit(u_colour, normalize(v_normal), 0.2), 1.0);
    }`,
  ],
  floor: [
    `in vec3 a_position; in vec2 a_place; uniform mat4 u_view, u_projection; out vec2 v_place;
    void main() { v_place = a_place; gl_Position = u_projection * u_view * vec4(a_position, 1); }`,
    `in vec2 v_place; uniform sampler2D u_shadow; uniform float u_step, u_reach, u_fade; uniform vec3 u_ink;
    out vec4 o_colour;
    float grid(float step) {
      vec2 at = v_place / step;
      vec2 width = max(fwidth(at), 1e-6);
      vec2 line = clamp(1.2 - abs(fract(at - 0.5) - 0.5) / width, 0.0, 1.0) * clamp(0.5 / width - 1.0, 0.0, 1.0);
      return max(line.x, line.y);
    }
    void main() {
      if (u_pick) discard;
      float near = 1.0 - smoothstep(0.35, 1.0, length(v_place) / u_reach);
      float line = max(0.15 * grid(u_step), 0.28 * grid(5.0 * u_step));
      float shadow = 0.42 * texture(u_shadow, 0.5 + 0.5 * v_place / u_reach).r;
      float alpha = u_fade * near * (line + shadow * (1.0 - line));
      o_colour = vec4(mix(u_ink, vec3(0.02, 0.03, 0.05), shadow / max(line + shadow, 1e-4)), alpha);
    }`,
  ],
  backdrop: [
    `in vec2 a_corner; out vec2 v_corner; void main() { v_corner = a_corner; gl_Position = vec4(a_corner, 1, 1); }`,
    `in vec2 v_corner; uniform vec3 u_inner, u_outer; out vec4 o_colour;
    void main() {
      float away = smoothstep(0.0, 1.5, length(v_corner - vec2(0, 0.15)));
      float grain = fract(sin(dot(gl_FragCoord.xy, vec2(12.9898, 78.233))) * 43758.5453) / 255.0; // against banding
      o_colour = vec4(mix(u_inner, u_outer, away) + grain - 0.5 / 255.0, 1);
    }`,
  ],
  stamp: [
    `in vec3 a_position; uniform mat4 u_view, u_projection;
    void main() { gl_Position = u_projection * u_view * vec4(a_position, 1); }`,
    `out vec4 o_colour; void main() { o_colour = vec4(1); }`,
  ],
  blur: [
    `in vec2 a_corner; out vec2 v_place; void main() { v_place = 0.5 + 0.5 * a_corner; gl_Position = vec4(a_corner, 0, 1); }`,
    `in vec2 v_place; uniform sampler2D u_source; uniform vec2 u_along; out vec4 o_colour;
    void main() {
      float sum = 0.0, weights = 0.0;
      for (int k = -12; k <= 12; k++) {
        float weight = exp(-float(k * k) / 50.0);
        sum += weight * texture(u_source, v_place + float(k) * u_along).r; weights += weight;
      }
      o_colour = vec4(vec3(sum / weights), 1);
    }`,
  ],
};

const SHADOW = 256; // pixels along the floor's shadow
const QUAD = new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]);

class Renderer {
  constructor(canvas) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: false });
    if (!gl) throw new Error("this page needs WebGL 2, which the browser does not offer here");
    this.gl = gl;
    this.canvas = canvas;
    this.programs = {};
    for (const [name, [vertex, fragment]] of Object.entries(SHADERS)) {
      this.programs[name] = this.program(name, vertex, LIGHT + fragment);
    }
    this.quad = this.buffer(QUAD);
    const shape = arrow();
    this.backdrop = this.object("backdrop", { a_corner: [2, this.quad] });
    this.balls = this.object("ball", { a_corner: [2, this.quad], a_position: [3, null, 1], a_colour: [3, null, 1] });
    this.last = this.object("ball", { a_corner: [2, this.quad], a_position: [3, null, 1], a_colour: [3, null, 1] });
    this.lines = this.lineObject();
    this.ticks = this.lineObject();
    this.arrows = this.object("arrow", {
      a_position: [3, this.buffer(shape.position)],
      a_normal: [3, this.buffer(shape.normal)],
      a_tip: [3, null, 1],
      a_away: [3, null, 1],
    });
    this.arrowCorners = shape.position.length / 3;
    this.arrowCount = 0;
    this.mesh = this.object("mesh", { a_position: [3], a_normal: [3], a_colour: [3] });
    this.stamp = this.object("stamp", { a_position: [3, this.mesh.buffers.a_position] });
    this.meshCorners = 0;
    this.floor = this.object("floor", { a_position: [3], a_place: [2] });
    this.blur = this.object("blur", { a_corner: [2, this.quad] });
    this.shadows = [0, 1].map(() => this.target(SHADOW, SHADOW, false));
    this.picked = this.target(1, 1, true);
  }

  program(name, vertex, fragment) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, `#version 300 es\nprecision highp float;\nprecision highp int;\n${source}`);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
        throw new Error(`${name}: ${gl.getShaderInfoLog(shader)}`);
      }
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`${name}: ${gl.getProgramInfoLog(program)}`);
    }
    return program;
  }

  buffer(data) {
    const { gl } = this;
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    if (data) gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    return buffer;
  }

  // attributes: name -> [components, buffer (a new one without), divisor]
  object(name, attributes) {
    const { gl } = this;
    const program = this.programs[name];
    const object = { program, array: gl.createVertexArray(), buffers: {} };
    gl.bindVertexArray(object.array);
    for (const [attribute, [components, given, divisor]] of Object.entries(attributes)) {
      const at = gl.getAttribLocation(program, attribute);
      const buffer = given || this.buffer();
      object.buffers[attribute] = buffer;
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, components, gl.FLOAT, false, 0, 0);
      if (divisor) gl.vertexAttribDivisor(at, divisor);
    }
    gl.bindVertexArray(null);
    return object;
  }

  lineObject() {
    return this.object("line", {
      a_corner: [2, this.quad],
      a_start: [3, null, 1],
      a_end: [3, null, 1],
      a_colour: [3, null, 1],
    });
  }

  fill(object, arrays) {
    const { gl } = this;
    for (const [attribute, data] of Object.entries(arrays)) {
      gl.bindBuffer(gl.ARRAY_BUFFER, object.buffers[attribute]);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    }
  }

  target(width, height, depth) {
    const { gl } = this;
    const target = { width, height, texture: gl.createTexture(), frame: gl.createFramebuffer() };
    gl.bindTexture(gl.TEXTURE_2D, target.texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, width, height);
    for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, wrap, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target.texture, 0);
    if (depth) {
      target.depth = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, target.depth);
      gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT16, width, height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, target.depth);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return target;
  }

  use(object, uniforms) {
    const { gl } = this;
    gl.useProgram(object.program);
    gl.bindVertexArray(object.array);
    for (const [name, value] of Object.entries(uniforms)) {
      const at = gl.getUniformLocation(object.program, name);
      if (at === null) continue; // a shader names what it needs of what all are offered
      if (value.length === 16) gl.uniformMatrix4fv(at, false, value);
      else if (value.length === 3) gl.uniform3fv(at, value);
      else if (value.length === 2) gl.uniform2fv(at, value);
      else if (name === "u_pick" || name === "u_first" || name === "u_shadow" || name === "u_source") gl.uniform1i(at, value);
      else gl.uniform1f(at, value);
    }
  }

  setContacts(positions, colours) {
    this.fill(this.balls, { a_position: positions, a_colour: colours });
    this.positions = positions;
    this.colours = colours;
  }

  setMesh(mesh) {
    this.meshCorners = mesh ? mesh.position.length / 3 : 0;
    if (mesh) this.fill(this.mesh, { a_position: mesh.position, a_normal: mesh.normal, a_colour: mesh.colour });
  }

  setArrows(tips, away) {
    this.fill(this.arrows, { a_tip: new Float32Array(tips.flat()), a_away: new Float32Array(away.flat()) });
    this.arrowCount = tips.length;
  }

  // The floor in the display's axes: at height y about (x, z), reaching as far as `reach`; `up` turns it into the scene.
  setFloor(up, [x, y, z], reach) {
    const place = [[-1, -1], [1, -1], [-1, 1], [1, 1]].map((corner) => corner.map((c) => c * reach));
    const position = place.map(([u, v]) => turnedBack(up, [x + u, y, z + v]));
    this.fill(this.floor, { a_position: new Float32Array(position.flat()), a_place: new Float32Array(place.flat()) });
    this.reach = reach;
    const { gl } = this;
    const [first, second] = this.shadows;
    // From below and without perspective: what is drawn lands where the floor looks it up.
    const rows = TO_Y_UP[up];
    const view = new Float32Array(16);
    view[15] = 1;
    for (let k = 0; k < 3; k++) {
      view[4 * k] = rows[0][k];
      view[4 * k + 1] = rows[2][k];
    }
    view[12] = -x;
    view[13] = -z;
    const flat = new Float32Array([1 / reach, 0, 0, 0, 0, 1 / reach, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1]);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    gl.viewport(0, 0, SHADOW, SHADOW);
    gl.bindFramebuffer(gl.FRAMEBUFFER, first.frame);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (this.meshCorners) {
      this.use(this.stamp, { u_view: view, u_projection: flat });
      gl.drawArrays(gl.TRIANGLES, 0, this.meshCorners);
    }
    for (const [from, to, along] of [[first, second, [1, 0]], [second, first, [0, 1]]]) {
      gl.bindFramebuffer(gl.FRAMEBUFFER, to.frame);
      gl.bindTexture(gl.TEXTURE_2D, from.texture);
      this.use(this.blur, { u_source: 0, u_along: along.map((c) => (0.9 * c) / SHADOW) });
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  // view: what page.js says of the camera, the colours and what is to be seen.
  draw(view) {
    const { gl, canvas } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.disable(gl.SCISSOR_TEST);
    gl.disable(gl.BLEND);
    gl.disable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.use(this.backdrop, { u_inner: view.inner, u_outer: view.outer });
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.enable(gl.DEPTH_TEST);
    this.things(view, { u_pick: 0, u_size: [canvas.width, canvas.height] });
  }

  things(view, extra) {
    const { gl } = this;
    const shared = {
      u_view: view.view,
      u_projection: view.projection,
      u_above: view.above,
      u_pixel: view.pixel,
      ...extra,
    };
    const mesh = (opacity, faces) => {
      this.use(this.mesh, { ...shared, u_opacity: opacity });
      if (faces) {
        gl.enable(gl.CULL_FACE);
        gl.cullFace(faces);
      }
      gl.drawArrays(gl.TRIANGLES, 0, this.meshCorners);
      gl.disable(gl.CULL_FACE);
    };
    const solid = view.meshShown && view.opacity === 1;
    if (solid) mesh(1, view.closed ? gl.BACK : null); // of a closed mesh no back is ever seen
    if (view.contactsShown) {
      gl.enable(gl.SAMPLE_ALPHA_TO_COVERAGE);
      this.use(this.balls, { ...shared, u_radius: view.radius, u_least: view.least, u_first: 1 });
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, view.count);
      if (view.lastShown && !extra.u_pick) {
        const at = 3 * (view.count - 1);
        this.fill(this.last, {
          a_position: this.positions.subarray(at, at + 3),
          a_colour: new Float32Array([...this.colours.subarray(at, at + 3)]),
        });
        this.use(this.last, { ...shared, u_radius: 2 * view.radius, u_least: 2 * view.least, u_first: view.count });
        gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, 1);
      }
      gl.disable(gl.SAMPLE_ALPHA_TO_COVERAGE);
    }
    if (view.arrowsShown && this.arrowCount) {
      this.use(this.arrows, { ...shared, u_length: view.arrow, u_colour: view.accent, u_first: ARROW_IDS });
      gl.drawArraysInstanced(gl.TRIANGLES, 0, this.arrowCorners, this.arrowCount);
    }
    if (extra.u_pick) return;

    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.depthMask(false);
    for (const [object, count, width] of [[this.lines, view.lines, 1.8], [this.ticks, view.ticks, 1.2]]) {
      if (!count) continue;
      this.use(object, { ...shared, u_width: width * view.density, u_lift: 0.008 });
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
    }
    gl.bindTexture(gl.TEXTURE_2D, this.shadows[0].texture);
    this.use(this.floor, { ...shared, u_step: view.step, u_reach: this.reach, u_fade: view.floor, u_ink: view.ink, u_shadow: 0 });
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    if (view.meshShown && !solid && view.opacity > 0) {
      mesh(0.6 * view.opacity, gl.FRONT);
      mesh(view.opacity, gl.BACK);
    }
    gl.depthMask(true);
    gl.disable(gl.BLEND);
  }

  // The number of what lies at a pixel of the canvas (from its upper left): contact 1, 2, ..., an arrow, or 0.
  pick(view, x, y) {
    const { gl, canvas } = this;
    // The projection that spreads this one pixel over the whole (one-pixel) picture.
    const [w, h] = [canvas.width, canvas.height];
    const narrow = new Float32Array([w, 0, 0, 0, 0, h, 0, 0, 0, 0, 1, 0, w - 2 * x - 1, 2 * y + 1 - h, 0, 1]);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.picked.frame);
    gl.viewport(0, 0, 1, 1);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.things({ ...view, projection: multiply(narrow, view.projection) }, { u_pick: 1, u_size: [1, 1] });
    const pixel = new Uint8Array(4);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return pixel[0] + 256 * pixel[1] + 65536 * pixel[2];
  }
}

const ARROW_IDS = 0xf00000; // contacts are fewer
