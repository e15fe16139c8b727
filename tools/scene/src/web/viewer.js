// Viewer of a scene of Gaussians in WebGL 2. It runs from files: no requests, no modules, no other code.
//
// Part of SGS, licensed under MIT or Apache-2.0 (license.txt). The conventions are those of the renderer of SGS: camera axes
// x right, y down, z forward; pixel centers at (i + 0.5, j + 0.5); order by depth along the camera's axis.
"use strict";

const ROW = 2048;                 // texels of a row of a data texture
const BRIGHTEST_HALF = 65504;
const $ = (id) => document.getElementById(id);

// Draws one quad per Gaussian, back to front. The quad is the square |p|, |q| <= reach of the footprint's own coordinates.
const SPLAT_VERTEX = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
layout(location = 0) in uint index;
uniform usampler2D geometry, colors;
uniform mat3 rotation;
uniform vec3 translation, position;
uniform vec2 focal, center, size;
uniform float near, offset, lowest;
uniform int terms, texels;
uniform bool mip;
out vec2 place;
flat out vec4 shown;

uvec4 texel(usampler2D data, int at) { return texelFetch(data, ivec2(at & ${ROW - 1}, at / ${ROW}), 0); }

void basis_of(vec3 d, out float b[16]) {
  float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  b = float[16](0.28209479177387814, -0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x,
    1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2.0 * zz - xx - yy),
    -1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy), -0.5900435899266435 * y * (3.0 * xx - yy),
    2.890611442640554 * x * y * z, -0.4570457994644658 * y * (4.0 * zz - xx - yy),
    0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy), -0.4570457994644658 * x * (4.0 * zz - xx - yy),
    1.445305721320277 * z * (xx - yy), -0.5900435899266435 * x * (xx - 3.0 * yy));
}

vec3 color_of(int i, vec3 mean) {
  float v[48];
  for (int t = 0; t < 6; ++t) {
    if (t >= texels) break;
    uvec4 w = texel(colors, i * texels + t);
    for (int k = 0; k < 4; ++k) {
      vec2 two = unpackHalf2x16(w[k]);
      v[8 * t + 2 * k] = two.x;
      v[8 * t + 2 * k + 1] = two.y;
    }
  }
  float basis[16];
  vec3 away = mean - position;
  basis_of(away * inversesqrt(max(dot(away, away), 1e-30)), basis);
  vec3 sum = vec3(offset);
  for (int b = 0; b < 16; ++b) {
    if (b >= terms) break;
    sum += basis[b] * vec3(v[3 * b], v[3 * b + 1], v[3 * b + 2]);
  }
  return max(sum, vec3(lowest));
}

void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0); // outside of the view
  place = vec2(0.0);
  shown = vec4(0.0);
  int i = int(index);
  uvec4 one = texel(geometry, 2 * i), two = texel(geometry, 2 * i + 1);
  vec3 mean = uintBitsToFloat(one.xyz);
  vec2 first = unpackUnorm2x16(one.w), second = unpackUnorm2x16(two.x);
  vec3 scale = exp(24.0 * vec3(first, second.x) - 16.0);
  float opacity = second.y;
  vec4 q = normalize(vec4(unpackSnorm2x16(two.y), unpackSnorm2x16(two.z)));
  vec3 point = rotation * mean + translation;
  float z = point.z;
  if (!(z >= near) || opacity < 1.0 / 255.0) return;
  float w = q.x;
  vec3 u = q.yzw;
  mat3 m = mat3(1.0 - 2.0 * (u.y * u.y + u.z * u.z), 2.0 * (u.x * u.y + w * u.z), 2.0 * (u.x * u.z - w * u.y),
    2.0 * (u.x * u.y - w * u.z), 1.0 - 2.0 * (u.x * u.x + u.z * u.z), 2.0 * (u.y * u.z + w * u.x),
    2.0 * (u.x * u.z + w * u.y), 2.0 * (u.y * u.z - w * u.x), 1.0 - 2.0 * (u.x * u.x + u.y * u.y));
  mat3 axes = rotation * mat3(m[0] * scale.x, m[1] * scale.y, m[2] * scale.z);
  // Linearized within 1.3 half fields of view of the image center.
  vec2 slope = point.xy / z, middle = (0.5 * size - center) / focal, most = 0.65 * size / focal;
  vec2 held = clamp(slope, middle - most, middle + most), f = focal / z;
  vec3 r0 = vec3(axes[0].x, axes[1].x, axes[2].x), r1 = vec3(axes[0].y, axes[1].y, axes[2].y);
  vec3 r2 = vec3(axes[0].z, axes[1].z, axes[2].z);
  vec3 t0 = f.x * (r0 - held.x * r2), t1 = f.y * (r1 - held.y * r2);
  float a = dot(t0, t0), b = dot(t0, t1), c = dot(t1, t1);
  vec3 minors = cross(t0, t1);
  float determinant = dot(minors, minors) + 0.3 * (a + c) + 0.09;
  if (!(determinant < 1e37)) return;
  if (mip) opacity *= sqrt(dot(minors, minors) / determinant);
  if (!(opacity >= 1.0 / 255.0)) return;
  c += 0.3;
  float root = inversesqrt(c), root_det = inversesqrt(determinant);
  vec3 factor = 0.849321800288019 * vec3(c * root * root_det, -b * root * root_det, root);
  if (!(factor.x > 0.0 && factor.z > 0.0)) return;
  float reach = sqrt(max(log2(255.0 * opacity) * 1.00001 + 1e-5, 0.0));
  place = reach * vec2(float(2 * (gl_VertexID & 1) - 1), float((gl_VertexID & 2) - 1));
  float dy = place.y / factor.z, dx = (place.x - factor.y * dy) / factor.x;
  vec2 at = focal * slope + center + vec2(dx, dy);
  gl_Position = vec4(2.0 * at.x / size.x - 1.0, 1.0 - 2.0 * at.y / size.y, 0.0, 1.0);
  shown = vec4(color_of(i, mean), opacity);
}`;

const SPLAT_FRAGMENT = `#version 300 es
precision highp float;
in vec2 place;
flat in vec4 shown;
out vec4 blended;
void main() {
  float alpha = min(0.99, shown.a * exp2(-dot(place, place)));
  if (alpha < 1.0 / 255.0) discard;
  blended = vec4(shown.rgb * alpha, alpha);
}`;

const SCREEN_VERTEX = `#version 300 es
void main() { gl_Position = vec4(float(4 * (gl_VertexID & 1) - 1), float(2 * (gl_VertexID & 2) - 1), 0.0, 1.0); }`;

// Shows blended colors: display values as they are without exposure, linear light in sRGB.
const SCREEN_FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D blended;
uniform vec3 background;
uniform float exposure;
uniform bool linear;
out vec4 color;
vec3 encode(vec3 v) {
  v = clamp(v, 0.0, 1.0);
  return mix(12.92 * v, 1.055 * pow(v, vec3(1.0 / 2.4)) - 0.055, vec3(greaterThan(v, vec3(0.0031308))));
}
vec3 decode(vec3 v) {
  v = clamp(v, 0.0, 1.0);
  return mix(v / 12.92, pow((v + 0.055) / 1.055, vec3(2.4)), vec3(greaterThan(v, vec3(0.04045))));
}
void main() {
  vec4 sum = texelFetch(blended, ivec2(gl_FragCoord.xy), 0);
  float rest = 1.0 - sum.a;
  vec3 light = linear ? encode(exposure * (sum.rgb + rest * decode(background))) : sum.rgb + rest * background;
  if (!linear && exposure != 1.0) light = encode(exposure * decode(light));
  color = vec4(light, 1.0);
}`;

// Runs in a worker: sorts Gaussians by depth along the camera's axis, farthest first. Two passes of 16 bits over the bits of
// the depth order all positive numbers exactly; Gaussians behind the near plane are left out.
function sorter() {
  let centers, depths, keys, order, loaded = 0, free = [];
  const counts = new Uint32Array(65536);
  onmessage = ({ data }) => {
    if (data.count !== undefined) {
      centers = new Float32Array(3 * data.count);
      depths = new Float32Array(data.count);
      keys = new Uint32Array(depths.buffer);
      order = new Uint32Array(data.count);
      return;
    }
    if (data.centers) { centers.set(data.centers, 3 * data.first); loaded = data.first + data.centers.length / 3; return; }
    if (data.free) { free.push(data.free); return; }
    const began = performance.now();
    const { axis, shift, near } = data;
    let n = 0;
    for (let i = 0; i < loaded; ++i) {
      const z = axis[0] * centers[3 * i] + axis[1] * centers[3 * i + 1] + axis[2] * centers[3 * i + 2] + shift;
      if (!(z >= near)) continue;
      depths[i] = z;
      order[n++] = i;
    }
    const pass = (from, to, low) => {
      counts.fill(0);
      for (let k = 0; k < n; ++k) ++counts[low ? keys[from[k]] & 65535 : keys[from[k]] >>> 16];
      let at = 0;
      for (let d = 65535; d >= 0; --d) { const c = counts[d]; counts[d] = at; at += c; }
      // Of equal depths, the first Gaussian is the nearest, as in the renderer.
      for (let k = 0; k < n; ++k) { const i = from[k]; to[counts[low ? keys[i] & 65535 : keys[i] >>> 16]++] = i; }
    };
    order.subarray(0, n).reverse();
    const sorted = free.pop() || new Uint32Array(order.length);
    pass(order, sorted, true);
    pass(sorted, order, false);
    sorted.set(order.subarray(0, n));
    postMessage({ sorted, n, loaded, ticket: data.ticket, ms: performance.now() - began }, [sorted.buffer]);
  };
}

let failed = false;

function fail(sentence) {
  failed = true;
  $("note").textContent = sentence;
  document.documentElement.dataset.state = "failed";
  throw new Error(sentence);
}

let viewer = null;

class Viewer {
  constructor(scene) {
    this.scene = scene;
    const gl = $("canvas").getContext("webgl2", { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" });
    if (!gl) fail("This page needs WebGL 2, which this browser does not offer; use a current browser with hardware acceleration switched on.");
    this.gl = gl;
    $("canvas").addEventListener("webglcontextlost", () => fail("The browser lost its graphics device; reload the page."));
    const wide = gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float");
    this.format = wide ? [gl.RGBA16F, gl.HALF_FLOAT] : [gl.RGBA8, gl.UNSIGNED_BYTE];
    this.splat = this.program(SPLAT_VERTEX, SPLAT_FRAGMENT);
    this.screen = this.program(SCREEN_VERTEX, SCREEN_FRAGMENT);
    const { count, degree, lights, light_degree } = scene;
    this.color = { terms: (degree + 1) ** 2 };
    this.light = { terms: (light_degree + 1) ** 2 };
    for (const c of [this.color, this.light]) c.texels = Math.ceil(3 * c.terms / 8);
    if (this.rows(Math.max(2, this.color.texels, this.light.texels)) > gl.getParameter(gl.MAX_TEXTURE_SIZE)) fail(`This scene has ${count} Gaussians, more than the textures of this graphics device hold; open the page on another device.`);
    this.geometry = this.texture(2);
    this.color.texture = this.texture(this.color.texels);
    if (lights.length) this.light.texture = this.texture(this.light.texels);
    this.responses = []; // by chunk, halves: [light][Gaussian][number]
    this.order = gl.createBuffer();
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.bufferData(gl.ARRAY_BUFFER, 4 * count, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    gl.bindVertexArray(null);
    this.empty = gl.createVertexArray();
    this.target = null;
    this.drawn = 0;      // Gaussians of the current order
    this.loaded = 0;
    this.ticket = 0;     // of the last requested order
    this.sorting = false;
    this.wanted = true;  // whether the view has changed since the last order was requested
    this.dirty = true;
    this.worker = new Worker(URL.createObjectURL(new Blob([`(${sorter})()`], { type: "text/javascript" })));
    this.worker.onmessage = (event) => this.take(event.data);
    this.worker.postMessage({ count });
  }

  program(vertex, fragment) {
    const gl = this.gl, made = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) fail(`This graphics device cannot run the shaders of the page: ${gl.getProgramInfoLog(made) || "unknown reason"}.`);
    const at = {};
    for (let i = 0; i < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); ++i) {
      const { name } = gl.getActiveUniform(made, i);
      at[name] = gl.getUniformLocation(made, name);
    }
    return { made, at };
  }

  // Rows of a data texture. All chunks take whole rows.
  rows(texels) { return Math.ceil(this.scene.count / this.scene.chunk) * this.scene.chunk * texels / ROW; }

  // Data texture with some texels of four words per Gaussian.
  texture(texels) {
    const gl = this.gl, made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, ROW, this.rows(texels));
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
    return made;
  }

  // Writes the words of a chunk. A chunk begins at a row.
  write(texture, texels, chunk, words) {
    const gl = this.gl, row = chunk * this.scene.chunk * texels / ROW;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, row, ROW, words.length / (4 * ROW), gl.RGBA_INTEGER, gl.UNSIGNED_INT, words);
  }

  // Room for the words of a chunk, up to the end of its last row.
  room(count, texels) { return new Uint32Array(4 * ROW * Math.ceil(count * texels / ROW)); }

  // Copies halves of `numbers` per Gaussian into texels.
  spread(halves, count, numbers, texels) {
    const words = this.room(count, texels), into = new Uint16Array(words.buffer);
    for (let i = 0; i < count; ++i) into.set(halves.subarray(i * numbers, (i + 1) * numbers), 8 * texels * i);
    return words;
  }

  // Takes the bytes of a chunk: geometry in 28 bytes, harmonics, then each light's response.
  add(chunk, bytes) {
    const first = chunk * this.scene.chunk, count = Math.min(this.scene.chunk, this.scene.count - first);
    const words = new Uint32Array(bytes.buffer, 0, 7 * count), floats = new Float32Array(bytes.buffer, 0, 7 * count);
    const halves = new Uint16Array(bytes.buffer, 28 * count), numbers = 3 * this.color.terms;
    const geometry = this.room(count, 2), centers = new Float32Array(3 * count);
    for (let i = 0; i < count; ++i) {
      for (let k = 0; k < 7; ++k) geometry[8 * i + k] = words[7 * i + k];
      for (let k = 0; k < 3; ++k) centers[3 * i + k] = floats[7 * i + k];
    }
    this.write(this.geometry, 2, chunk, geometry);
    this.write(this.color.texture, this.color.texels, chunk, this.spread(halves, count, numbers, this.color.texels));
    if (this.scene.lights.length) {
      this.responses[chunk] = halves.slice(numbers * count);
      this.weigh(chunk);
    }
    this.loaded = first + count;
    this.worker.postMessage({ first, centers }, [centers.buffer]);
    this.wanted = this.dirty = true;
  }

  // Sums the responses of a chunk to the lights, weighed by their colors and intensities.
  weigh(chunk) {
    const halves = this.responses[chunk], numbers = 3 * this.light.terms, lights = this.scene.lights;
    const count = halves.length / (numbers * lights.length), sums = new Float32Array(numbers * count);
    lights.forEach((light, l) => {
      const by = weight_of(light);
      if (by.every((v) => v === 0)) return;
      const from = l * numbers * count;
      for (let i = 0; i < sums.length; ++i) sums[i] += by[i % 3] * FLOATS[halves[from + i]];
    });
    const packed = new Uint16Array(sums.length);
    for (let i = 0; i < sums.length; ++i) packed[i] = half(sums[i]);
    this.write(this.light.texture, this.light.texels, chunk, this.spread(packed, count, numbers, this.light.texels));
  }

  relight() {
    for (const chunk of this.responses.keys()) this.weigh(chunk);
    this.dirty = true;
  }

  // Requests an order for the current view, one at a time.
  order_for(view) {
    if (!this.wanted || this.sorting) return;
    this.sorting = true;
    this.wanted = false;
    const axis = view.rotation[2];
    this.worker.postMessage({ axis, shift: view.translation[2], near: view.near, ticket: ++this.ticket });
  }

  take({ sorted, n, loaded, ms }) {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, sorted, 0, n);
    this.worker.postMessage({ free: sorted }, [sorted.buffer]);
    this.drawn = n;
    this.ordered = loaded;
    this.sorting = false;
    this.dirty = true;
    $("sort").textContent = `${ms.toFixed(1)} ms`;
  }

  resize(width, height) {
    const gl = this.gl, canvas = $("canvas");
    if (this.target && canvas.width === width && canvas.height === height) return;
    [canvas.width, canvas.height] = [width, height];
    if (this.target) { gl.deleteFramebuffer(this.target.frame); gl.deleteTexture(this.target.texture); }
    const texture = gl.createTexture(), frame = gl.createFramebuffer();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, this.format[0], width, height);
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
    this.target = { texture, frame };
    this.dirty = true;
  }

  // Draws a view: { rotation (rows), translation, position, focal, center, near }, in pixels of the canvas.
  draw(view, relit, exposure) {
    const gl = this.gl, canvas = $("canvas"), { at } = this.splat, colors = relit ? this.light : this.color;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.frame);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.useProgram(this.splat.made);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    [this.geometry, colors.texture].forEach((texture, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    });
    gl.uniform1i(at.geometry, 0);
    gl.uniform1i(at.colors, 1);
    gl.uniformMatrix3fv(at.rotation, true, view.rotation.flat());
    gl.uniform3fv(at.translation, view.translation);
    gl.uniform3fv(at.position, view.position);
    gl.uniform2fv(at.focal, view.focal);
    gl.uniform2fv(at.center, view.center);
    gl.uniform2f(at.size, canvas.width, canvas.height);
    gl.uniform1f(at.near, view.near);
    gl.uniform1f(at.offset, relit ? 0 : 0.5);
    gl.uniform1f(at.lowest, relit ? -BRIGHTEST_HALF : 0);
    gl.uniform1i(at.terms, colors.terms);
    gl.uniform1i(at.texels, colors.texels);
    gl.uniform1i(at.mip, this.scene.antialiased ? 1 : 0);
    gl.bindVertexArray(this.array);
    if (this.drawn) gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.drawn);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.BLEND);
    gl.useProgram(this.screen.made);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, this.target.texture);
    gl.uniform1i(this.screen.at.blended, 0);
    gl.uniform3fv(this.screen.at.background, this.scene.background);
    gl.uniform1f(this.screen.at.exposure, exposure);
    gl.uniform1i(this.screen.at.linear, relit ? 1 : 0);
    gl.bindVertexArray(this.empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    this.dirty = false;
  }
}

// Values of all halves.
const FLOATS = (() => {
  const all = new Float32Array(65536);
  for (let h = 0; h < 65536; ++h) {
    const e = (h >> 10) & 31, m = h & 1023, v = e === 0 ? m * 2 ** -24 : e === 31 ? NaN : (1 + m / 1024) * 2 ** (e - 15);
    all[h] = h & 32768 ? -v : v;
  }
  return all;
})();

const BITS = new Uint32Array(1), AS_FLOAT = new Float32Array(BITS.buffer);

// The half next to a number within their range.
function half(value) {
  AS_FLOAT[0] = Math.max(-BRIGHTEST_HALF, Math.min(BRIGHTEST_HALF, value));
  const bits = BITS[0], sign = (bits >>> 16) & 32768, size = bits & 0x7fffffff;
  if (size < 0x38800000) return sign | Math.round(Math.abs(AS_FLOAT[0]) * 2 ** 24);
  return sign | ((size - 0x38000000 + 0xfff + ((size >>> 13) & 1)) >>> 13);
}

const decode_srgb = (v) => (v > 0.04045 ? ((v + 0.055) / 1.055) ** 2.4 : v / 12.92);
const encode_srgb = (v) => (v > 0.0031308 ? 1.055 * v ** (1 / 2.4) - 0.055 : 12.92 * v);

// Factors of a light's response per channel.
function weight_of({ on, intensity, color }) { return color.map((v) => (on ? intensity * v : 0)); }
