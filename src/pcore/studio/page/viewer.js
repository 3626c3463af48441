"use strict";
// Draws the splats that `packing.py` wrote: decoded and sorted here, projected by the shader as
// pcore's own renderer projects them (pixel filter, opacity compensation, sorted from behind).

const byId = (name) => document.getElementById(name);
const HEAD = JSON.parse(byId("head").textContent);
const N = HEAD.count, T = HEAD.moments;

function say(text, state) {
  byId("message").textContent = text;
  document.body.dataset.state = state;
}

// ---- data -------------------------------------------------------------------------------------

async function unpacked() {
  const text = atob(byId("data").textContent);
  const raw = new Uint8Array(text.length);
  for (let i = 0; i < raw.length; i++) raw[i] = text.charCodeAt(i);
  byId("data").remove();
  const stream = new Blob([raw]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  const kinds = {uint8: Uint8Array, int8: Int8Array, uint16: Uint16Array};
  const arrays = {};
  for (const [name, place] of Object.entries(HEAD.arrays))
    arrays[name] = new kinds[place.type](buffer, place.from, place.length);
  return arrays;
}

class Splats {
  constructor(arrays) {
    this.arrays = arrays;
    this.means = new Float32Array(3 * N);
    this.shapes = new Float32Array(6 * N);
    this.turns = HEAD.degree ? new Float32Array(4 * N) : null;
    this.gains = new Float32Array(N);
    const K = (HEAD.degree + 1) ** 2, {low, high, most} = HEAD.colors;
    this.sh = new Float32Array(K * 3 * N);
    for (let i = 0; i < 3 * N; i++) this.sh[i] = low + arrays.first[i] * (high - low) / 255;
    for (let k = 1; k < K; k++) {
      const share = most[Math.floor(Math.sqrt(k)) - 1] / 127;
      for (let i = 0; i < 3 * N; i++) this.sh[k * 3 * N + i] = arrays.others[(k - 1) * 3 * N + i] * share;
    }
    this.shown = new Float32Array(13 * N);
    this.depths = new Float32Array(N);
    this.order = new Uint32Array(N);
    this.keys = new Uint16Array(N);
    this.time = -1;
  }

  at(time) {  // time in moments, 0 to T - 1; means and Cholesky factors linear between two
    if (time === this.time) return;
    this.time = time;
    const first = Math.min(Math.floor(time), Math.max(T - 2, 0)), f = time - first;
    const next = Math.min(first + 1, T - 1);
    const {means, scales, factors, turns, gains} = this.arrays;
    const [low, high] = HEAD.box, [small, large] = HEAD.sizes;
    for (let c = 0; c < 3; c++) {
      const a = (first * 3 + c) * N, b = (next * 3 + c) * N, room = (high[c] - low[c]) / 65535;
      for (let i = 0; i < N; i++)
        this.means[3 * i + c] = low[c] + room * (means[a + i] * (1 - f) + means[b + i] * f);
    }
    const step = (large - small) / 65535, l = [0, 0, 0, 0, 0, 0];
    for (let i = 0; i < N; i++) {
      const p = Math.exp(small + step * scales[first * N + i]) / 127 * (1 - f);
      const q = Math.exp(small + step * scales[next * N + i]) / 127 * f;
      for (let c = 0; c < 6; c++)
        l[c] = p * factors[(first * 6 + c) * N + i] + q * factors[(next * 6 + c) * N + i];
      const s = this.shapes, j = 6 * i;
      s[j] = l[0] * l[0]; s[j + 1] = l[0] * l[1]; s[j + 2] = l[0] * l[3];
      s[j + 3] = l[1] * l[1] + l[2] * l[2]; s[j + 4] = l[1] * l[3] + l[2] * l[4];
      s[j + 5] = l[3] * l[3] + l[4] * l[4] + l[5] * l[5];
      const g = gains[first * N + i] * (1 - f) + gains[next * N + i] * f;
      this.gains[i] = 2 ** ((g - 128) / HEAD.gain);
    }
    if (!this.turns) return;
    for (let i = 0; i < N; i++) {
      let along = 0, norm = 0;
      for (let c = 0; c < 4; c++)
        along += turns[(first * 4 + c) * N + i] * turns[(next * 4 + c) * N + i];
      const g = along < 0 ? -f : f;
      for (let c = 0; c < 4; c++) {
        const value = turns[(first * 4 + c) * N + i] * (1 - f) + turns[(next * 4 + c) * N + i] * g;
        this.turns[4 * i + c] = value;
        norm += value * value;
      }
      norm = Math.sqrt(norm) || 1;
      for (let c = 0; c < 4; c++) this.turns[4 * i + c] /= norm;
    }
  }

  // Real harmonics in the order and with the signs of `pcore.gaussians.spherical_harmonics`.
  static basis(x, y, z, out) {
    out[0] = 0.28209479177387814;
    if (HEAD.degree < 1) return;
    out[1] = -0.4886025119029199 * y; out[2] = 0.4886025119029199 * z;
    out[3] = -0.4886025119029199 * x;
    if (HEAD.degree < 2) return;
    const xx = x * x, yy = y * y, zz = z * z;
    out[4] = 1.0925484305920792 * x * y; out[5] = -1.0925484305920792 * y * z;
    out[6] = 0.31539156525252005 * (2 * zz - xx - yy); out[7] = -1.0925484305920792 * x * z;
    out[8] = 0.5462742152960396 * (xx - yy);
    if (HEAD.degree < 3) return;
    out[9] = -0.5900435899266435 * y * (3 * xx - yy); out[10] = 2.890611442640554 * x * y * z;
    out[11] = -0.4570457994644658 * y * (4 * zz - xx - yy);
    out[12] = 0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy);
    out[13] = -0.4570457994644658 * x * (4 * zz - xx - yy);
    out[14] = 1.445305721320277 * z * (xx - yy); out[15] = -0.5900435899266435 * x * (xx - 3 * yy);
  }

  sorted(eye, forward) {  // from behind, by counting
    const {means, depths, order, keys} = this;
    let near = Infinity, far = -Infinity;
    for (let i = 0; i < N; i++) {
      const d = (means[3 * i] - eye[0]) * forward[0] + (means[3 * i + 1] - eye[1]) * forward[1]
        + (means[3 * i + 2] - eye[2]) * forward[2];
      depths[i] = d;
      if (d < near) near = d;
      if (d > far) far = d;
    }
    const share = 65535 / Math.max(far - near, 1e-9), starts = new Uint32Array(65537);
    for (let i = 0; i < N; i++) {
      keys[i] = (far - depths[i]) * share;
      starts[keys[i] + 1]++;
    }
    for (let k = 0; k < 65536; k++) starts[k + 1] += starts[k];
    for (let i = 0; i < N; i++) order[starts[keys[i]]++] = i;
  }

  fill(eye, forward) {  // instances for the shader: centre, shape, colour and opacity
    this.sorted(eye, forward);
    const {means, shapes, turns, gains, sh, shown, order} = this;
    const K = (HEAD.degree + 1) ** 2, b = new Float32Array(16);
    Splats.basis(0, 0, 1, b);
    for (let n = 0; n < N; n++) {
      const i = order[n], o = 13 * n;
      for (let c = 0; c < 3; c++) shown[o + c] = means[3 * i + c];
      for (let c = 0; c < 6; c++) shown[o + 3 + c] = shapes[6 * i + c];
      if (turns) {
        let x = means[3 * i] - eye[0], y = means[3 * i + 1] - eye[1], z = means[3 * i + 2] - eye[2];
        const r = 1 / (Math.hypot(x, y, z) || 1);
        x *= r; y *= r; z *= r;
        // The direction as the splat at rest would see it: turned back by the quaternion.
        const w = turns[4 * i], p = -turns[4 * i + 1], q = -turns[4 * i + 2], s = -turns[4 * i + 3];
        const a = 2 * (q * z - s * y), e = 2 * (s * x - p * z), h = 2 * (p * y - q * x);
        Splats.basis(x + w * a + q * h - s * e, y + w * e + s * a - p * h,
          z + w * h + p * e - q * a, b);
      }
      for (let c = 0; c < 3; c++) {
        let value = 0.5;
        for (let k = 0; k < K; k++) value += b[k] * sh[(k * 3 + c) * N + i];
        shown[o + 9 + c] = Math.max(value, 0) * gains[i];
      }
      shown[o + 12] = this.arrays.opacities[i] / 255;
    }
    return shown;
  }
}

// ---- drawing ----------------------------------------------------------------------------------

const VERTEX = `#version 300 es
precision highp float;
layout(location = 0) in vec2 corner;
layout(location = 1) in vec3 center;
layout(location = 2) in vec3 upper;   // xx xy xz
layout(location = 3) in vec3 lower;   // yy yz zz
layout(location = 4) in vec4 color;
uniform mat3 camera;                  // rows: right, down, forward
uniform vec3 eye;
uniform vec2 size;
uniform vec4 lens;                    // focal length, variance of a pixel, compensate, near
out vec2 place;
out vec4 shade;
void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  vec3 local = (center - eye) * camera;
  if (local.z < lens.w) return;
  vec2 room = size * 0.65 / lens.x, slope = local.xy / local.z;
  vec2 held = clamp(slope, -room, room);
  float per = lens.x / local.z;
  mat3 shape = mat3(upper.x, upper.y, upper.z, upper.y, lower.x, lower.y, upper.z, lower.y, lower.z);
  vec3 across = per * (camera[0] - held.x * camera[2]), down = per * (camera[1] - held.y * camera[2]);
  vec3 along = shape * across;
  float xx = dot(across, along), xy = dot(down, along), yy = dot(down, shape * down);
  float before = xx * yy - xy * xy;
  xx += lens.y; yy += lens.y;
  float area = xx * yy - xy * xy;
  float opacity = color.a;
  if (lens.z > 0.5) opacity *= sqrt(clamp(before / area, 1e-12, 1.0));
  if (opacity < 1.0 / 255.0) return;
  float reach = sqrt(2.0 * log(opacity * 255.0));
  float middle = 0.5 * (xx + yy), apart = sqrt(max(0.25 * (xx - yy) * (xx - yy) + xy * xy, 0.0));
  float large = middle + apart, small = max(middle - apart, 0.25 * area / large);
  vec2 axis = abs(xy) > 1e-9 ? normalize(vec2(large - yy, xy)) : (xx >= yy ? vec2(1, 0) : vec2(0, 1));
  place = corner * reach;
  shade = vec4(color.rgb, opacity);
  vec2 pixel = 0.5 * size + lens.x * slope
    + axis * place.x * sqrt(large) + vec2(-axis.y, axis.x) * place.y * sqrt(small);
  gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec2 place;
in vec4 shade;
out vec4 result;
void main() {
  float alpha = min(shade.a * exp(-0.5 * dot(place, place)), 0.999);
  if (alpha < 1.0 / 255.0) discard;
  result = vec4(shade.rgb * alpha, alpha);
}`;

const OVER_VERTEX = `#version 300 es
layout(location = 0) in vec2 corner;
void main() { gl_Position = vec4(corner, 0.0, 1.0); }`;

const OVER_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture;
uniform vec3 background;
out vec4 result;
void main() {
  vec4 sum = texelFetch(picture, ivec2(gl_FragCoord.xy), 0);
  result = vec4(sum.rgb + (1.0 - sum.a) * background, 1.0);
}`;

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost())
      throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  return made;
}

class Screen {
  constructor(canvas) {
    this.canvas = canvas;
    const gl = this.gl = canvas.getContext("webgl2", {antialias: false, alpha: false,
      preserveDrawingBuffer: true});
    if (!gl) throw new Error("This page needs WebGL 2. Please try another browser, or switch on "
      + "hardware acceleration.");
    // Sums of many faint splats need more than the 8 bits of a canvas.
    this.fine = Boolean(gl.getExtension("EXT_color_buffer_float"));
    this.splats = program(gl, VERTEX, FRAGMENT);
    this.over = program(gl, OVER_VERTEX, OVER_FRAGMENT);
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    this.instances = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.instances);
    [[1, 3, 0], [2, 3, 12], [3, 3, 24], [4, 4, 36]].forEach(([place, count, from]) => {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, count, gl.FLOAT, false, 52, from);
      gl.vertexAttribDivisor(place, 1);
    });
    this.texture = gl.createTexture();
    this.target = gl.createFramebuffer();
    this.width = this.height = 0;
  }

  resized(width, height) {
    if (width === this.width && height === this.height) return;
    const gl = this.gl;
    this.canvas.width = this.width = width;
    this.canvas.height = this.height = height;
    gl.bindTexture(gl.TEXTURE_2D, this.texture);
    const kind = this.fine ? [gl.RGBA16F, gl.HALF_FLOAT] : [gl.RGBA8, gl.UNSIGNED_BYTE];
    gl.texImage2D(gl.TEXTURE_2D, 0, kind[0], width, height, 0, gl.RGBA, kind[1], null);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.texture, 0);
  }

  draw(instances, view) {
    const gl = this.gl, use = (name) => gl.getUniformLocation(this.splats, name);
    gl.viewport(0, 0, this.width, this.height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(this.splats);
    gl.uniformMatrix3fv(use("camera"), false, view.axes.flat());
    gl.uniform3fv(use("eye"), view.eye);
    gl.uniform2f(use("size"), this.width, this.height);
    const focal = 0.5 * this.height / Math.tan(0.5 * HEAD.angle * Math.PI / 180);
    gl.uniform4f(use("lens"), focal, HEAD.variance, HEAD.antialiased ? 1 : 0, 0.02 * view.distance);
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.instances);
    gl.bufferData(gl.ARRAY_BUFFER, instances, gl.DYNAMIC_DRAW);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, N);
    gl.disable(gl.BLEND);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.useProgram(this.over);
    gl.uniform3fv(gl.getUniformLocation(this.over, "background"), HEAD.background);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, 1);
  }
}

// ---- camera -----------------------------------------------------------------------------------

const sum = (a, b, f = 1) => a.map((value, k) => value + f * b[k]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

class Orbit {  // around a place; angles in radians, in axes to the right, ahead and up
  constructor() { this.home(); }

  home() {
    this.target = [...HEAD.center];
    // As far as the object fits the narrower side of the window.
    this.distance = HEAD.distance * Math.max(1, innerHeight / Math.max(innerWidth, 1));
    this.azimuth = -Math.PI / 4;
    this.elevation = 25 * Math.PI / 180;
  }

  from(eye, target) {
    const away = sum(eye, target, -1), offset = HEAD.axes.map((axis) => dot(axis, away));
    this.target = target;
    this.distance = Math.sqrt(dot(offset, offset));
    this.azimuth = Math.atan2(offset[1], offset[0]);
    this.elevation = Math.asin(offset[2] / this.distance);
  }

  get view() {
    const [ca, sa] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    const [ce, se] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    const out = [ce * ca, ce * sa, se], right = [-sa, ca, 0], down = [se * ca, se * sa, -ce];
    const [x, y, z] = HEAD.axes;
    const [r, d, o] = [right, down, out].map((v) =>
      x.map((_, k) => v[0] * x[k] + v[1] * y[k] + v[2] * z[k]));
    return {axes: [r, d, o.map((v) => -v)], eye: sum(this.target, o, this.distance),
      distance: this.distance};
  }

  turn(x, y) {
    this.azimuth -= 0.008 * x;
    this.elevation = Math.max(-1.55, Math.min(1.55, this.elevation + 0.008 * y));
  }

  shift(x, y, height) {
    const per = 2 * this.distance * Math.tan(0.5 * HEAD.angle * Math.PI / 180) / height;
    const [right, down] = this.view.axes;
    this.target = sum(sum(this.target, right, -per * x), down, -per * y);
  }

  zoom(factor) {
    this.distance = Math.max(0.02 * HEAD.distance, Math.min(20 * HEAD.distance,
      this.distance * factor));
  }
}

// ---- page -------------------------------------------------------------------------------------

function wired(canvas, orbit, redraw) {
  const held = new Map();
  let spread = 0;
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    try { canvas.setPointerCapture(event.pointerId); } catch { /* gone already */ }
    held.set(event.pointerId, [event.clientX, event.clientY]);
    spread = 0;
    canvas.classList.add("held");
    byId("hint").classList.add("away");
  });
  const released = (event) => {
    held.delete(event.pointerId);
    spread = 0;
    if (!held.size) canvas.classList.remove("held");
  };
  canvas.addEventListener("pointerup", released);
  canvas.addEventListener("pointercancel", released);
  canvas.addEventListener("pointermove", (event) => {
    const before = held.get(event.pointerId);
    if (!before) return;
    const [x, y] = [event.clientX - before[0], event.clientY - before[1]];
    held.set(event.pointerId, [event.clientX, event.clientY]);
    if (held.size > 1) {  // two fingers: pan by their middle, zoom by their distance
      const [a, b] = [...held.values()];
      const now = Math.hypot(a[0] - b[0], a[1] - b[1]);
      orbit.shift(x / held.size, y / held.size, canvas.clientHeight);
      if (spread && now) orbit.zoom(spread / now);
      spread = now;
    } else if (event.buttons & 6 || event.shiftKey) orbit.shift(x, y, canvas.clientHeight);
    else orbit.turn(x, y);
    redraw();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    orbit.zoom(Math.exp(Math.max(-0.5, Math.min(0.5, event.deltaY * 0.0015))));
    redraw();
  }, {passive: false});
  canvas.addEventListener("dblclick", () => { orbit.home(); redraw(); });
}

function asked(orbit) {  // #eye=x,y,z&at=x,y,z&time=0.5&bare
  const wish = new URLSearchParams(location.hash.slice(1));
  const place = (name) => (wish.get(name) || "").split(",").map(Number);
  const good = (values) => values.length === 3 && values.every(Number.isFinite);
  if (good(place("eye")) && good(place("at"))) orbit.from(place("eye"), place("at"));
  if (wish.has("bare")) document.body.dataset.bare = "";
  const time = Number(wish.get("time"));
  return Number.isFinite(time) ? Math.max(0, Math.min(1, time)) : 0;
}

async function main() {
  const [r, g, b] = HEAD.background;
  document.body.classList.toggle("dark", 0.3 * r + 0.6 * g + 0.1 * b < 0.5);
  document.body.style.setProperty("--paper", `rgb(${[r, g, b].map((v) => 255 * v).join(" ")})`);
  const canvas = byId("view"), screen = new Screen(canvas), orbit = new Orbit();
  const splats = new Splats(await unpacked());
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  let time = asked(orbit), playing = false, before = 0, waiting = false;
  const touch = matchMedia("(pointer: coarse)").matches;
  byId("hint").textContent = touch ? "drag to orbit, two fingers to zoom and move"
    : "drag to orbit, wheel to zoom, right button to move";

  const redraw = () => {
    if (!waiting) requestAnimationFrame(frame);
    waiting = true;
  };
  function frame(now) {
    waiting = false;
    if (playing && before) time = (time + (now - before) / 1000 / HEAD.seconds) % 1;
    before = playing ? now : 0;
    if (playing) byId("time").value = time;
    const sharp = Math.min(window.devicePixelRatio || 1, 2);
    screen.resized(Math.max(1, Math.round(canvas.clientWidth * sharp)),
      Math.max(1, Math.round(canvas.clientHeight * sharp)));
    const view = orbit.view;
    splats.at(time * (T - 1));
    screen.draw(splats.fill(view.eye, view.axes[2]), view);
    if (playing) redraw();
  }
  function play(on) {
    playing = on && T > 1;
    byId("play").textContent = playing ? "Pause" : "Play";
    redraw();
  }

  wired(canvas, orbit, redraw);
  byId("timeline").hidden = T < 2;
  byId("time").value = time;
  byId("time").addEventListener("input", (event) => { play(false); time = Number(event.target.value);
    redraw(); });
  byId("play").addEventListener("click", () => play(!playing));
  byId("home").addEventListener("click", () => { orbit.home(); redraw(); });
  window.addEventListener("resize", redraw);
  window.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "INPUT") return;
    const steps = {ArrowLeft: [12, 0], ArrowRight: [-12, 0], ArrowUp: [0, 12], ArrowDown: [0, -12]};
    if (event.key === " " && event.target.tagName !== "BUTTON") play(!playing);
    else if (event.key === "f" || event.key === "F") orbit.home();
    else if (event.key === "+" || event.key === "=") orbit.zoom(0.9);
    else if (event.key === "-") orbit.zoom(1 / 0.9);
    else if (event.key in steps) orbit.turn(...steps[event.key]);
    else return;
    event.preventDefault();
    redraw();
  });
  canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault();
    say("The graphics card was taken away; please reload the page.", "failed"); });
  frame(0);
  say("", "ready");
  if (T > 1 && !still && !location.hash) play(true);
}

main().catch((problem) => say(problem.message || String(problem), "failed"));
