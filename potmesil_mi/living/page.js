
// Living pictures: every <script class="living-picture"> of the page has the JSON of one, which is
// shown in the figure before it. Its pictures stand at places of the focus, 0 near to 1 far; what
// is between is a blend of two, in sRGB. Apertures are clicked from one to the next.

const GLIDE = 250; // milliseconds from one focus to the next
const FADE = 150; // milliseconds from one aperture to the next
const KEPT = 96 * 2 ** 20; // bytes of decoded pictures of all figures that are kept, about
const DECODING = 3; // pictures that are decoded at once
const AHEAD = 4; // pictures on each side of the focus that are decoded before they are asked for
const STEPS = 100; // of the focus by arrow keys, from near to far
const QUIET = 500; // milliseconds of rest after which a screen reader is told what is shown

const bytesOf = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
const clamp = (value, least, most) => Math.min(Math.max(value, least), most);
const isStill = () => matchMedia("(prefers-reduced-motion: reduce)").matches;

// ---------------------------------------------------------------- blending

const VERTEX = `#version 300 es
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  gl_Position = vec4(4.0 * corner - 1.0, 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D pictures[4];
uniform vec4 weights;
out vec4 color;
void main() {
  int height = textureSize(pictures[0], 0).y;
  ivec2 at = ivec2(gl_FragCoord.x, height - 1 - int(gl_FragCoord.y)); // Rows go downwards.
  vec3 sum = weights.x * texelFetch(pictures[0], at, 0).rgb;
  if (weights.y > 0.0) sum += weights.y * texelFetch(pictures[1], at, 0).rgb;
  if (weights.z > 0.0) sum += weights.z * texelFetch(pictures[2], at, 0).rgb;
  if (weights.w > 0.0) sum += weights.w * texelFetch(pictures[3], at, 0).rgb;
  color = vec4(sum, 1.0);
}`;

// Draws sums of pictures by WebGL2; one for all figures, for browsers allow but few.
class Blender {
  constructor() {
    this.canvas = new OffscreenCanvas(1, 1);
    this.gl = this.canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false });
    if (!this.gl) throw new Error("no WebGL2");
    this.canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      surfaces.clear();
    });
    this.canvas.addEventListener("webglcontextrestored", () => {
      this.begin();
      figures.forEach((figure) => figure.changed());
    });
    this.begin();
  }

  begin() {
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    gl.useProgram(program);
    gl.uniform1iv(gl.getUniformLocation(program, "pictures"), [0, 1, 2, 3]);
    this.weights = gl.getUniformLocation(program, "weights");
  }

  // A decoded picture as it is drawn from; the bitmap is given up.
  take(bitmap) {
    const gl = this.gl;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, bitmap.width, bitmap.height);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
    bitmap.close();
    return texture;
  }

  drop(texture) {
    this.gl.deleteTexture(texture);
  }

  // Draws the sum of [surface, weight]s, four at most.
  draw(context, parts) {
    const gl = this.gl;
    const { width, height } = context.canvas;
    if (gl.isContextLost()) return;
    if (this.canvas.width !== width) this.canvas.width = width;
    if (this.canvas.height !== height) this.canvas.height = height;
    gl.viewport(0, 0, width, height);
    const weights = [0, 0, 0, 0];
    for (let i = 0; i < 4; i += 1) {
      gl.activeTexture(gl.TEXTURE0 + i);
      gl.bindTexture(gl.TEXTURE_2D, (parts[i] ?? parts[0])[0]);
      weights[i] = parts[i]?.[1] ?? 0;
    }
    gl.activeTexture(gl.TEXTURE0);
    gl.uniform4fv(this.weights, weights);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    context.transferFromImageBitmap(this.canvas.transferToImageBitmap());
  }

  contextOf(canvas) {
    return canvas.getContext("bitmaprenderer", { alpha: false });
  }
}

// The same without WebGL2: slower, and rounded several times.
class PlainBlender {
  take(bitmap) {
    return bitmap;
  }

  drop(bitmap) {
    bitmap.close();
  }

  draw(context, parts) {
    let sum = 0;
    for (const [bitmap, weight] of parts) {
      sum += weight;
      context.globalAlpha = sum > 0 ? weight / sum : 0;
      context.drawImage(bitmap, 0, 0);
    }
  }

  contextOf(canvas) {
    return canvas.getContext("2d", { alpha: false });
  }
}

// ---------------------------------------------------------------- decoded pictures

// The pictures of all figures that are decoded, those used last at the end.
class Surfaces {
  constructor() {
    this.found = new Map();
    this.bytes = 0;
    this.wanted = new Map();
    this.decoding = new Set();
  }

  get(key) {
    const entry = this.found.get(key);
    if (entry) {
      this.found.delete(key);
      this.found.set(key, entry);
    }
    return entry?.surface;
  }

  // What is to be decoded next for a figure, [key, data]s, in the place of what it wanted before.
  want(figure, list) {
    this.wanted.set(figure, list);
    this.next();
  }

  next() {
    // Figures that wait come before those that look ahead.
    const order = [...this.wanted.keys()].sort((a, b) => a.settled - b.settled);
    for (const figure of order) {
      const list = this.wanted.get(figure);
      while (list.length && this.decoding.size < DECODING) {
        const [key, text] = list.shift();
        if (!this.found.has(key) && !this.decoding.has(key)) this.decode(key, text);
      }
    }
  }

  async decode(key, text) {
    this.decoding.add(key);
    try {
      const blob = new Blob([bytesOf(text)], { type: "image/jpeg" });
      const bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none" });
      const size = 4 * bitmap.width * bitmap.height;
      while (this.bytes + size > KEPT && this.found.size > 4) this.forget();
      this.found.set(key, { surface: blender.take(bitmap), size });
      this.bytes += size;
    } finally {
      this.decoding.delete(key);
      this.next();
    }
    figures.forEach((figure) => figure.arrived());
  }

  forget() {
    const [key, entry] = this.found.entries().next().value;
    this.found.delete(key);
    this.bytes -= entry.size;
    blender.drop(entry.surface);
  }

  clear() {
    this.found.clear();
    this.bytes = 0;
  }
}

// ---------------------------------------------------------------- one living picture

class LivingPicture {
  constructor(figure, data, number) {
    this.figure = figure;
    this.data = data;
    this.number = number;
    this.image = figure.querySelector("img");
    this.place = this.from = this.target = data.opened[0];
    this.level = this.before = data.opened[1];
    this.began = this.turned = -Infinity;
    this.build();
    this.describe();
    this.readDepth();
    this.changed();
  }

  build() {
    const { data, figure } = this;
    const view = figure.querySelector(".view");
    this.canvas = document.createElement("canvas");
    [this.canvas.width, this.canvas.height] = data.size;
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.hidden = true;
    this.context = blender.contextOf(this.canvas);
    this.mark = document.createElement("div");
    this.mark.className = "mark";
    view.append(this.canvas, this.mark);

    const bar = document.createElement("div");
    bar.className = "bar";
    [this.focus, this.distance] = slider(bar, "Focus", "focus", 1000);
    [this.aperture, this.opening] = slider(bar, "Aperture", "aperture", data.levels.length - 1);
    this.status = document.createElement("p");
    this.status.className = "hidden";
    this.status.setAttribute("role", "status");
    this.status.setAttribute("aria-live", "polite");
    const caption = document.createElement("figcaption");
    const lens = `${Number(data.focal_length.toPrecision(3))} mm`;
    caption.textContent = [data.title, lens, "click or drag on what is to be sharp; arrow keys"]
      .filter(Boolean)
      .join(" · ");
    figure.append(bar, caption, this.status);
    if (blender instanceof PlainBlender) {
      const note = document.createElement("p");
      note.className = "note";
      note.textContent = "This browser has no WebGL2: the picture is drawn without it, more slowly.";
      figure.append(note);
    }
    this.listen();
  }

  listen() {
    const { canvas, focus, aperture } = this;
    focus.addEventListener("input", () => this.focusOn(focus.value / 1000, false));
    aperture.addEventListener("input", () => this.open(Number(aperture.value)));
    const turn = (event) => {
      event.preventDefault();
      this.open(this.level + Math.sign(event.deltaY));
    };
    aperture.parentElement.addEventListener("wheel", turn, { passive: false });
    // Within another page, and beside other pictures, the wheel over a picture scrolls.
    if (figuresOnPage === 1 && window.top === window) {
      canvas.addEventListener("wheel", (event) => event.ctrlKey || turn(event), { passive: false });
    }
    canvas.addEventListener("pointerenter", () => this.settled && this.prefetch());
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      canvas.setPointerCapture(event.pointerId);
      this.pick(event);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (canvas.hasPointerCapture(event.pointerId)) this.pick(event);
    });
    const keys = {
      ArrowLeft: () => this.focusOn(this.target - 1 / STEPS, false),
      ArrowRight: () => this.focusOn(this.target + 1 / STEPS, false),
      ArrowUp: () => this.open(this.level - 1),
      ArrowDown: () => this.open(this.level + 1),
      PageUp: () => this.focusOn(this.target - 10 / STEPS),
      PageDown: () => this.focusOn(this.target + 10 / STEPS),
      Home: () => this.focusOn(0),
      End: () => this.focusOn(1),
    };
    canvas.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.altKey || event.metaKey || !keys[event.key]) return;
      event.preventDefault();
      keys[event.key]();
    });
  }

  async readDepth() {
    const stream = new Blob([bytesOf(this.data.depth)]).stream();
    const steps = stream.pipeThrough(new DecompressionStream("deflate"));
    const depth = new Uint8Array(await new Response(steps).arrayBuffer());
    const [width] = this.data.size;
    for (let i = 0; i < depth.length; i += 1) {
      if (i % width) depth[i] += depth[i - 1]; // Steps from pixel to pixel, modulo 256.
    }
    this.depth = depth;
  }

  // Focus on what is seen where the pointer is.
  pick(event) {
    if (!this.depth) return;
    const [width, height] = this.data.size;
    const box = this.canvas.getBoundingClientRect();
    const across = (event.clientX - box.left) / box.width;
    const down = (event.clientY - box.top) / box.height;
    const column = clamp(Math.floor(across * width), 0, width - 1);
    const row = clamp(Math.floor(down * height), 0, height - 1);
    this.mark.style.left = `${clamp(event.clientX - box.left, 0, box.width)}px`;
    this.mark.style.top = `${clamp(event.clientY - box.top, 0, box.height)}px`;
    this.mark.classList.add("on");
    clearTimeout(this.marked);
    this.marked = setTimeout(() => this.mark.classList.remove("on"), 400);
    this.focusOn(this.depth[row * width + column] / 255);
  }

  focusOn(place, glides = true) {
    this.target = clamp(place, 0, 1);
    this.from = glides && !isStill() ? this.place : this.target;
    this.began = performance.now();
    this.isUsed = true;
    this.changed();
  }

  open(level) {
    const opened = clamp(level, 0, this.data.levels.length - 1);
    if (opened === this.level) return;
    this.before = isStill() ? opened : this.level;
    this.level = opened;
    this.turned = performance.now();
    this.isUsed = true;
    this.changed();
  }

  // Something else is to be shown than is.
  changed() {
    this.settled = false;
    this.describe();
    this.request();
  }

  request() {
    this.asked ??= requestAnimationFrame((now) => {
      this.asked = undefined;
      this.step(now);
    });
  }

  // A picture that was wanted has been decoded.
  arrived() {
    if (!this.settled) this.request();
  }

  step(now) {
    const time = clamp((now - this.began) / GLIDE, 0, 1);
    const eased = time * time * (3 - 2 * time);
    const place = this.from + (this.target - this.from) * eased;
    const share = this.before === this.level ? 1 : clamp((now - this.turned) / FADE, 0, 1);
    const parts = this.around(this.level, place, share);
    if (share < 1) parts.push(...this.around(this.before, place, 1 - share));
    const surfacesOf = parts.map(([key, , weight]) => [surfaces.get(key), weight]);
    const isMoving = time < 1 || share < 1;
    if (surfacesOf.every(([surface]) => surface)) {
      blender.draw(this.context, surfacesOf);
      this.place = place;
      this.canvas.hidden = false;
      this.image.hidden = true;
      this.canvas.dataset.place = place;
      this.canvas.dataset.level = this.level;
      this.settled = !isMoving;
    } else {
      // What is shown stays until the pictures are there: that of another focus would be wrong.
      const ends = this.around(this.level, this.target, 1);
      surfaces.want(this, [...parts, ...ends]);
    }
    if (isMoving) this.request();
    if (this.settled) {
      this.before = this.level;
      this.from = this.target;
      if (this.isUsed) this.prefetch();
    }
  }

  // [key, data, weight] of the pictures that those at a place are made of.
  around(level, place, weight) {
    const { places } = this.data.levels[level];
    let last = places.findIndex((one) => one >= place);
    last = Math.max(last, 1);
    const share = (place - places[last - 1]) / (places[last] - places[last - 1]);
    return [
      this.picture(level, last - 1, weight * (1 - share)),
      this.picture(level, last, weight * share),
    ].filter(([, , part]) => part > 0);
  }

  picture(level, index, weight) {
    const key = `${this.number}/${level}/${index}`;
    return [key, this.data.levels[level].pictures[index], weight];
  }

  // Decode what is likely to be asked for next: the focus nearby, and the apertures next to this.
  prefetch() {
    const { levels } = this.data;
    const { places } = levels[this.level];
    const here = Math.max(places.findIndex((one) => one >= this.target), 1);
    const near = [];
    for (let i = 0; i < AHEAD; i += 1) {
      for (const index of [here + i, here - 1 - i]) {
        if (places[index] !== undefined) near.push(this.picture(this.level, index, 1));
      }
    }
    for (const level of [this.level + 1, this.level - 1]) {
      if (levels[level]) near.push(...this.around(level, this.target, 1));
    }
    const [width, height] = this.data.size;
    surfaces.want(this, near.slice(0, KEPT / (8 * width * height)));
  }

  describe() {
    const { data, target } = this;
    const [near, far] = data.vergences;
    const distance = lengthOf(data.millimeters_per_unit / (near + target * (far - near)));
    const opening = `f/${Number(data.levels[this.level].f_number.toPrecision(3))}`;
    this.focus.value = Math.round(target * 1000);
    this.aperture.value = this.level;
    this.distance.value = distance;
    this.opening.value = opening;
    this.focus.setAttribute("aria-valuetext", distance);
    this.aperture.setAttribute("aria-valuetext", opening);
    const text = `focused at ${distance}, ${opening}`;
    const name = data.title || "A picture to refocus";
    this.canvas.setAttribute(
      "aria-label",
      `${name}, ${text}. Left and right arrow keys focus, up and down change the aperture.`,
    );
    clearTimeout(this.told);
    if (this.canvas.hidden) return; // Nobody has asked for anything yet.
    this.told = setTimeout(() => {
      this.status.textContent = text;
    }, QUIET);
  }
}

// A slider with its name and what it says; returns the input and the output.
function slider(bar, name, kind, most) {
  const label = document.createElement("label");
  label.className = kind;
  const input = document.createElement("input");
  const output = document.createElement("output");
  input.type = "range";
  input.min = 0;
  input.max = most;
  input.disabled = most < 1;
  output.setAttribute("aria-hidden", "true");
  label.append(name, input, output);
  input.setAttribute("aria-label", name);
  bar.append(label);
  return [input, output];
}

function lengthOf(millimeters) {
  if (millimeters === Infinity) return "infinity";
  const [size, unit] =
    millimeters >= 1e6 ? [1e6, "km"] : millimeters >= 1e3 ? [1e3, "m"]
      : millimeters >= 100 ? [10, "cm"] : [1, "mm"];
  return `${Number((millimeters / size).toPrecision(3))} ${unit}`;
}

// ---------------------------------------------------------------- the page

function chosenBlender() {
  try {
    return new Blender();
  } catch {
    return new PlainBlender();
  }
}

const figures = [];
const surfaces = new Surfaces();
const blender = chosenBlender();
const scripts = [...document.querySelectorAll("script.living-picture")];
const figuresOnPage = scripts.length;

scripts.forEach((script, number) => {
  const figure = script.previousElementSibling;
  const data = JSON.parse(script.textContent);
  script.remove();
  figures.push(new LivingPicture(figure, data, number));
});
