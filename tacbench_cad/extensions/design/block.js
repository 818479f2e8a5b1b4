"use strict";
// Draws a block in 3D from the heights of its top, with WebGL 2 and without a library.
class BlockView {
  static COARSE = 4;

  static FINE_AFTER_MS = 250;

  static COLOURS = ["#2b1d5b", "#2f5d8c", "#2f8f86", "#7cc04f", "#f6e65a"];

  static VERTEX = `#version 300 es
    precision highp float; precision highp sampler2D;
    uniform sampler2D heights; uniform ivec2 lines; uniform vec2 size; uniform mat4 camera; uniform bool wall;
    out vec3 place; out vec3 normal;
    float height(ivec2 at) { return texelFetch(heights, clamp(at, ivec2(0), lines - 1), 0).r; }
    void main() {
      vec2 pitch = size / vec2(lines - 1);
      ivec2 at; float z;
      if (wall) {
        // The border counter-clockwise, two vertices at each line: on the top and on the underside.
        int k = gl_VertexID / 2, n = lines.x - 1, m = lines.y - 1; k -= (k / (2 * (n + m))) * 2 * (n + m);
        if (k < n) { at = ivec2(k, 0); normal = vec3(0, -1, 0); }
        else if (k < n + m) { at = ivec2(n, k - n); normal = vec3(1, 0, 0); }
        else if (k < 2 * n + m) { at = ivec2(2 * n + m - k, m); normal = vec3(0, 1, 0); }
        else { at = ivec2(0, 2 * (n + m) - k); normal = vec3(-1, 0, 0); }
        z = gl_VertexID % 2 == 0 ? height(at) : 0.0;
      } else {
        at = ivec2(gl_VertexID % lines.x, gl_VertexID / lines.x); z = height(at);
        ivec2 low = max(at - 1, ivec2(0)), high = min(at + 1, lines - 1);
        vec2 slope = vec2(height(ivec2(high.x, at.y)) - height(ivec2(low.x, at.y)), height(ivec2(at.x, high.y)) - height(ivec2(at.x, low.y)))
          / (vec2(high - low) * pitch);
        normal = vec3(-slope, 1.0);
      }
      place = vec3(vec2(at) * pitch, z);
      gl_Position = camera * vec4(place, 1.0);
    }`;

  static FRAGMENT = `#version 300 es
    precision highp float;
    uniform vec3 colours[5]; uniform vec2 range; uniform bool wall; uniform vec3 cut; uniform float mark;
    in vec3 place; in vec3 normal; out vec4 colour;
    vec3 ramp(float t) { t = clamp(t, 0.0, 1.0) * 4.0; int i = min(int(t), 3); return mix(colours[i], colours[i + 1], t - float(i)); }
    void main() {
      if (!wall && place.z < 1e-3) discard;  // outside of the outline
      vec3 n = normalize(normal);
      float light = 0.42 + 0.62 * max(0.0, dot(n, normalize(vec3(-0.45, -0.6, 1.0))));
      bool side = wall || place.z < range.x - 0.01 * (range.y - range.x);
      vec3 base = side ? vec3(0.62, 0.66, 0.70) : ramp((place.z - range.x) / (range.y - range.x));
      colour = vec4(base * light, 1.0);
      if (!wall && abs(dot(cut.xy, place.xy) - cut.z) < mark) colour.rgb = vec3(0.69, 0.29, 0.0);
    }`;

  constructor(canvas) {
    this.canvas = canvas;
    this.turn = -0.5; this.tilt = 0.75; this.zoom = 1;
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false });
    if (!gl) throw new Error("This browser cannot draw the block in 3D (it needs WebGL 2). The cut is still drawn.");
    this.gl = gl;
    // Without a graphics card the processor draws. Then the picture is coarser as long as it changes. A graphics card
    // draws four pixels for each pixel of the screen, which makes the edges smooth.
    const card = gl.getExtension("WEBGL_debug_renderer_info");
    const software = card && /swiftshader|llvmpipe|software|basic render/i.test(gl.getParameter(card.UNMASKED_RENDERER_WEBGL));
    [this.coarse, this.dense] = software ? [BlockView.COARSE, 1] : [1, 2];
    this.program = this.#program();
    this.names = new Map();
    this.cells = new Map();
    this.lines = [0, 0];
    gl.useProgram(this.program);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0.965, 0.969, 0.976, 1);
    const rgb = BlockView.COLOURS.flatMap((hex) => [1, 3, 5].map((i) => parseInt(hex.slice(i, i + 2), 16) / 255));
    gl.uniform3fv(this.#at("colours"), rgb);
    this.#listen();
    new ResizeObserver(() => this.draw(1)).observe(canvas);
  }

  #program() {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, BlockView.VERTEX], [gl.FRAGMENT_SHADER, BlockView.FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(`WebGL: ${gl.getProgramInfoLog(program)}`);
    return program;
  }

  #at(name) {
    if (!this.names.has(name)) this.names.set(name, this.gl.getUniformLocation(this.program, name));
    return this.names.get(name);
  }

  #listen() {
    const canvas = this.canvas, from = new Map();
    canvas.addEventListener("pointerdown", (event) => { from.set(event.pointerId, [event.clientX, event.clientY]); canvas.setPointerCapture(event.pointerId); });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => from.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      const old = from.get(event.pointerId);
      if (!old) return;
      const now = [event.clientX, event.clientY];
      if (from.size === 1) this.#move((now[0] - old[0]) * 0.008, (now[1] - old[1]) * 0.008, 1);
      else {  // two fingers: their distance zooms
        const [other] = [...from].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
        const apart = (place) => Math.hypot(place[0] - other[0], place[1] - other[1]) || 1;
        this.#move(0, 0, apart(now) / apart(old));
      }
      from.set(event.pointerId, now);
    });
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.#move(0, 0, Math.exp(-0.0015 * event.deltaY)); }, { passive: false });
    const keys = { ArrowLeft: [-0.1, 0, 1], ArrowRight: [0.1, 0, 1], ArrowUp: [0, -0.1, 1], ArrowDown: [0, 0.1, 1], "+": [0, 0, 1.15], "=": [0, 0, 1.15], "-": [0, 0, 1 / 1.15] };
    canvas.addEventListener("keydown", (event) => {
      if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      this.#move(...keys[event.key]);
    });
  }

  #move(turn, tilt, zoom) {
    this.turn += turn;
    this.tilt = Math.min(Math.PI / 2 - 0.01, Math.max(0.02, this.tilt + tilt));
    this.zoom = Math.min(12, Math.max(0.4, this.zoom * zoom));
    this.draw();
  }

  // heights: the rows of the grid, x running fastest. cut: [1 or 0, 0 or 1, mm], the line x or y = mm.
  show(heights, lines, size, range, cut) {
    const gl = this.gl, [n, m] = lines;
    Object.assign(this, { size, range, cut });
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, n, m, 0, gl.RED, gl.FLOAT, heights);
    if (n !== this.lines[0] || m !== this.lines[1]) {
      for (const { buffer } of this.cells.values()) gl.deleteBuffer(buffer);
      this.cells.clear();
      this.lines = lines;
    }
    this.draw();
  }

  // The triangles between every line, or between every fourth line and the last.
  #cells(step) {
    if (!this.cells.has(step)) {
      const gl = this.gl, lines = (n) => [...Array(Math.ceil((n - 1) / step)).keys()].map((i) => i * step).concat(n - 1);
      const [xs, ys] = this.lines.map(lines), corners = new Uint32Array(6 * (xs.length - 1) * (ys.length - 1));
      let k = 0;
      for (let j = 1; j < ys.length; j += 1) {
        for (let i = 1; i < xs.length; i += 1, k += 6) {
          const [low, high] = [ys[j - 1] * this.lines[0], ys[j] * this.lines[0]], [a, b] = [xs[i - 1], xs[i]];
          corners.set([low + a, low + b, high + b, low + a, high + b, high + a], k);
        }
      }
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
      this.cells.set(step, { buffer, count: corners.length });
    }
    return this.cells.get(step);
  }

  // The product of perspective and view, by columns, as WebGL reads it.
  #camera(aspect) {
    const [x, y] = this.size, radius = Math.hypot(x, y, this.range[1]) / 2;
    const lens = 1 / Math.tan(0.3), away = (1.05 * radius * lens) / Math.min(1, aspect) / this.zoom;
    const [s, c, st, ct] = [Math.sin(this.turn), Math.cos(this.turn), Math.sin(this.tilt), Math.cos(this.tilt)];
    const right = [c, s, 0], up = [-s * st, c * st, ct], back = [s * ct, -c * ct, st];
    const middle = [x / 2, y / 2, this.range[1] / 2], dot = (a) => a[0] * middle[0] + a[1] * middle[1] + a[2] * middle[2];
    const near = Math.max(away - 1.5 * radius, 0.02 * radius), far = away + 1.5 * radius;
    const rows = [right, up, back].map((axis, i) => [...axis, -dot(axis) - (i === 2 ? away : 0)]);
    const a = (near + far) / (near - far), b = (2 * near * far) / (near - far);
    return [0, 1, 2, 3].flatMap((i) => [(lens / aspect) * rows[0][i], lens * rows[1][i], a * rows[2][i] + (i === 3 ? b : 0), -rows[2][i]]);
  }

  // Keeps the coarse picture, because another one follows soon.
  hold() { clearTimeout(this.later); }

  draw(step = this.coarse) {
    if (!this.size) return;
    this.hold();
    if (step > 1) this.later = setTimeout(() => this.draw(1), BlockView.FINE_AFTER_MS);
    const gl = this.gl, box = this.canvas.getBoundingClientRect(), dense = step > 1 ? 0.5 : this.dense * Math.min(1.5, devicePixelRatio);
    const [wide, high] = [Math.max(1, Math.round(box.width * dense)), Math.max(1, Math.round(box.height * dense))];
    if (this.canvas.width !== wide || this.canvas.height !== high) Object.assign(this.canvas, { width: wide, height: high });
    gl.viewport(0, 0, wide, high);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const [n, m] = this.lines;
    gl.uniform2i(this.#at("lines"), n, m);
    gl.uniform2f(this.#at("size"), ...this.size);
    gl.uniform2f(this.#at("range"), ...this.range);
    gl.uniform3f(this.#at("cut"), ...this.cut);
    gl.uniform1f(this.#at("mark"), 0.004 * Math.max(...this.size));
    gl.uniformMatrix4fv(this.#at("camera"), false, this.#camera(wide / high));
    gl.uniform1i(this.#at("wall"), 0);
    const { buffer, count } = this.#cells(step);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
    gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
    gl.uniform1i(this.#at("wall"), 1);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 2 * (2 * (n + m - 2) + 1));
  }
}
