// The viewer's front end: a module of anywidget, which the page of `potmesil live` uses, too.
//
// It keeps what is asked for, a whole question each time, and asks again only when it has the
// answer to the last: no picture is formed that nobody looks at any more. While one drags it asks
// for small pictures, and for the full one when one stops.

const REST = 160; // Milliseconds without a change after which the full picture is asked for.
const PATIENCE = 250; // Milliseconds after which it is shown that one waits.
const LOST = 20000; // Milliseconds after which there may be nobody who answers.
const ZOOM = 4; // Of the loupe.
const LOUPE = 200; // Its side on the screen.

const OVERLAYS = {
  none: "picture",
  depth: "depth",
  circles: "circles of confusion",
  sharp: "what is sharp",
  difference: "difference to thinlens",
};

let viewers = 0;

function render({ model, el }) {
  const about = model.get("about");
  const me = `${Date.now().toString(36)}-${(viewers += 1)}`;
  const asked = { ...about.start };
  const parts = build(el, about, asked);
  const picture = new Picture(parts.canvas, parts.loupe, about);

  // ------------------------------------------------------------ asking

  let number = 0;
  let waiting = null; // What is to be asked next.
  let underway = false; // Whether an answer is still to come.
  let rest = 0;
  let patience = 0;
  let lost = 0;
  let held = false; // Whether a slider is: the full picture is asked for when it is let go.

  function ask(small, at = null) {
    clearTimeout(rest);
    waiting = { ...asked, at, small: small && about.has_small };
    if (small && !held) rest = setTimeout(() => ask(false), REST);
    next();
  }

  function next() {
    if (underway || waiting === null) return;
    underway = true;
    number += 1;
    model.send({ ...waiting, id: `${me}:${number}` });
    waiting = null;
    clearTimeout(patience);
    patience = setTimeout(() => parts.root.setAttribute("aria-busy", "true"), PATIENCE);
    clearTimeout(lost);
    lost = setTimeout(() => say("There is no answer yet. Is the kernel running?"), LOST);
  }

  function answered(message, buffers) {
    if (message.kind === "ended") {
      underway = true; // For ever.
      clearTimeout(patience);
      clearTimeout(lost);
      say(message.text);
      return;
    }
    if (message.id !== `${me}:${number}`) return; // Of another view of the same widget.
    underway = false;
    clearTimeout(patience);
    clearTimeout(lost);
    if (message.kind === "error") {
      say(message.text);
    } else {
      say("");
      if (waiting === null) follow(message);
      picture.show(message, buffers[0]);
    }
    if (waiting === null && message.more) ask(false);
    if (waiting === null && !message.more) parts.root.setAttribute("aria-busy", "false");
    next();
  }

  // ------------------------------------------------------------ what is shown

  function say(text) {
    parts.error.textContent = text;
    parts.error.hidden = text === "";
    if (text !== "") parts.root.setAttribute("aria-busy", "false");
  }

  /** Let the controls show the lens of an answer, which a click may have chosen. */
  function follow(message) {
    asked.focus_distance = message.focus_distance;
    parts.focus.value = nearest(about.foci, message.focus_distance);
    tell(parts.focus, message.focus_text);
    tell(parts.opening, message.opening_text);
    parts.line.textContent = message.line;
    if ("note" in message) parts.note.textContent = message.note;
    parts.note.hidden = parts.note.textContent === "";
    if (message.python) parts.python.textContent = message.python;
    if (message.xml) parts.xml.textContent = message.xml;
  }

  function controls() {
    asked.focus_distance = about.foci[parts.focus.value];
    tell(parts.focus, about.focus_texts[parts.focus.value]);
  }

  // ------------------------------------------------------------ controls

  for (const name of ["focus", "opening", "blades", "exposure"]) {
    parts[name].addEventListener("pointerdown", () => (held = true));
    for (const end of ["pointerup", "pointercancel"]) {
      parts[name].addEventListener(end, () => {
        held = false;
        ask(false);
      });
    }
  }
  parts.focus.addEventListener("input", () => {
    controls();
    ask(true);
  });
  parts.opening.addEventListener("input", () => {
    asked.opening = about.openings[parts.opening.value];
    tell(parts.opening, about.opening_texts[parts.opening.value]);
    ask(true);
  });
  parts.blades.addEventListener("input", () => {
    asked.blades = Number(parts.blades.value);
    tell(parts.blades, String(asked.blades));
    ask(true);
  });
  parts.exposure.addEventListener("input", () => {
    asked.exposure = Number(parts.exposure.value);
    tell(parts.exposure, stops(asked.exposure));
    ask(true);
  });
  parts.shape.addEventListener("change", () => {
    asked.shape = parts.shape.value;
    parts.blades.closest(".pm-control").hidden = asked.shape !== "polygon";
    ask(false);
  });
  for (const name of ["method", "overlay"]) {
    parts[name].addEventListener("change", () => {
      asked[name] = parts[name].value;
      ask(false);
    });
  }

  // ------------------------------------------------------------ the picture

  function focusAt(x, y) {
    parts.mark.style.left = `${(100 * x) / about.width}%`;
    parts.mark.style.top = `${(100 * y) / about.height}%`;
    parts.mark.classList.remove("pm-pulse");
    void parts.mark.offsetWidth; // Begin the animation anew.
    parts.mark.classList.add("pm-pulse");
    ask(false, [x, y]);
  }

  parts.canvas.addEventListener("click", (event) => focusAt(...picture.place(event)));
  parts.canvas.addEventListener("pointermove", (event) => {
    if (parts.magnify.checked) picture.magnify(...picture.place(event));
  });
  parts.canvas.addEventListener("pointerleave", () => picture.magnify(null));
  parts.magnify.addEventListener("change", () => picture.magnify(null));

  // With the keyboard: the arrows move a cross over the picture, and Enter focuses there.
  let cross = [about.width / 2, about.height / 2];
  const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
  function showCross(shown) {
    parts.cross.hidden = !shown;
    parts.cross.style.left = `${(100 * cross[0]) / about.width}%`;
    parts.cross.style.top = `${(100 * cross[1]) / about.height}%`;
    picture.magnify(...(shown && parts.magnify.checked ? cross : [null]));
  }
  parts.canvas.addEventListener("keydown", (event) => {
    const move = moves[event.key];
    if (move) {
      const step = Math.max(about.width, about.height) / (event.shiftKey ? 400 : 40);
      cross = [clamp(cross[0] + step * move[0], about.width), clamp(cross[1] + step * move[1], about.height)];
      showCross(true);
    } else if (event.key === "Enter" || event.key === " ") {
      focusAt(...cross);
    } else {
      return;
    }
    event.preventDefault();
  });
  parts.canvas.addEventListener("blur", () => showCross(false));

  for (const [button, text] of [[parts.copyPython, parts.python], [parts.copyXml, parts.xml]]) {
    button.addEventListener("click", () => copy(text, parts.copied));
  }

  // ------------------------------------------------------------ begin

  model.on("msg:custom", answered);
  ask(about.has_small);
  return () => {
    clearTimeout(rest);
    clearTimeout(patience);
    clearTimeout(lost);
    model.off("msg:custom", answered);
  };
}

/** The picture on its canvas, of which the newest is drawn last, and the loupe over it. */
class Picture {
  constructor(canvas, loupe, about) {
    this.canvas = canvas;
    this.loupe = loupe;
    this.about = about;
    this.drawn = Promise.resolve();
    this.under = null;
  }

  show(message, buffer) {
    const decoded = createImageBitmap(new Blob([buffer], { type: message.type }));
    this.drawn = Promise.all([decoded, this.drawn]).then(([bitmap]) => {
      const context = this.canvas.getContext("2d", { willReadFrequently: true }); // By the loupe.
      context.imageSmoothingQuality = "high";
      context.drawImage(bitmap, ...message.box);
      bitmap.close();
      this.canvas.dataset.shown = message.id;
      this.canvas.dataset.small = message.small;
      if (this.under) this.magnify(...this.under);
    });
  }

  /** The place of a pointer in pixels of the picture. */
  place(event) {
    const box = this.canvas.getBoundingClientRect();
    const { width, height } = this.about;
    return [
      clamp(((event.clientX - box.left) * width) / box.width, width),
      clamp(((event.clientY - box.top) * height) / box.height, height),
    ];
  }

  /** Show what is around a place, each pixel as a square; nothing without a place. */
  magnify(x, y) {
    this.under = x === null ? null : [x, y];
    this.loupe.hidden = x === null;
    if (x === null) return;
    const context = this.loupe.getContext("2d");
    const seen = LOUPE / ZOOM;
    context.imageSmoothingEnabled = false;
    context.clearRect(0, 0, LOUPE, LOUPE);
    const [left, top] = [Math.round(x - seen / 2), Math.round(y - seen / 2)];
    context.drawImage(this.canvas, left, top, seen, seen, 0, 0, LOUPE, LOUPE);
    // Beside what is looked at, on whichever side there is more room.
    this.loupe.style.left = x < this.about.width / 2 ? "auto" : "0.5rem";
    this.loupe.style.right = x < this.about.width / 2 ? "0.5rem" : "auto";
  }
}

// ---------------------------------------------------------------- the elements

function build(el, about, asked) {
  const id = (name) => `pm-${viewers}-${name}`;
  const root = make("section", { class: "pm-viewer", "aria-label": "Refocusing viewer" });
  const parts = { root };

  const stage = make("div", { class: "pm-stage" });
  parts.canvas = make("canvas", {
    width: about.width,
    height: about.height,
    tabindex: 0,
    role: "application",
    "aria-roledescription": "picture",
    "aria-label": "The picture. A click focuses on what is there; so does Enter, on the cross that the arrow keys move.",
  });
  parts.loupe = make("canvas", { class: "pm-loupe", width: LOUPE, height: LOUPE, hidden: "", "aria-hidden": "true" });
  parts.mark = make("span", { class: "pm-mark", "aria-hidden": "true" });
  parts.cross = make("span", { class: "pm-cross", hidden: "", "aria-hidden": "true" });
  const busy = make("span", { class: "pm-busy", "aria-hidden": "true" });
  const frame = make("div", { class: "pm-frame" }, parts.canvas, parts.mark, parts.cross, parts.loupe, busy);
  frame.style.setProperty("--width", `${about.width}px`);
  parts.line = make("p", { class: "pm-line", role: "status" }, "Forming the picture …");
  parts.error = make("p", { class: "pm-error", role: "alert", hidden: "" });
  parts.note = make("p", { class: "pm-note", hidden: "" });
  stage.append(frame, parts.line, parts.error, parts.note);

  const panel = make("form", { class: "pm-panel", "aria-label": "Lens" });
  panel.addEventListener("submit", (event) => event.preventDefault());

  const slider = (name, label, settings, text) => {
    parts[name] = make("input", { type: "range", id: id(name), ...settings });
    const output = make("output", { for: id(name) });
    panel.append(
      make("div", { class: "pm-control" }, make("label", { for: id(name) }, label), output, parts[name]),
    );
    tell(parts[name], text);
  };
  const choice = (name, label, texts, value) => {
    const options = Object.entries(texts).map(([key, text]) => make("option", { value: key }, text));
    parts[name] = make("select", { id: id(name) }, ...options);
    parts[name].value = value;
    panel.append(make("div", { class: "pm-control" }, make("label", { for: id(name) }, label), parts[name]));
  };
  const focus = nearest(about.foci, asked.focus_distance);
  const opening = nearest(about.openings, asked.opening);
  slider("focus", "Focus", { min: 0, max: about.foci.length - 1, value: focus }, about.focus_texts[focus]);
  slider("opening", "Aperture", { min: 0, max: about.openings.length - 1, value: opening }, about.opening_texts[opening]);
  choice("shape", "Shape", about.shapes, asked.shape);
  slider("blades", "Blades", { min: about.blades[0], max: about.blades[1], value: asked.blades }, String(asked.blades));
  parts.blades.closest(".pm-control").hidden = asked.shape !== "polygon";
  choice("method", "Method", about.methods, asked.method);
  slider("exposure", "Exposure", { min: -about.stops, max: about.stops, step: 0.25, value: asked.exposure }, stops(asked.exposure));
  choice("overlay", "Show", Object.fromEntries(about.overlays.map((one) => [one, OVERLAYS[one]])), asked.overlay);
  parts.magnify = make("input", { type: "checkbox", id: id("magnify") });
  panel.append(
    make("div", { class: "pm-control pm-check" }, parts.magnify, make("label", { for: id("magnify") }, "Loupe, 400 %")),
  );

  parts.python = make("pre", { tabindex: 0, "aria-label": "The lens in Python" });
  parts.xml = make("pre", { tabindex: 0, "aria-label": "The sensor in XML" });
  parts.copyPython = make("button", { type: "button" }, "Python");
  parts.copyXml = make("button", { type: "button" }, "XML");
  parts.copied = make("span", { role: "status", class: "pm-copied" });
  panel.append(
    make("div", { class: "pm-copy" }, make("span", {}, "Copy the lens"), parts.copyPython, parts.copyXml, parts.copied),
    make("details", {}, make("summary", {}, "The lens as text"), parts.python, parts.xml),
  );

  if (about.title) stage.prepend(make("h2", { class: "pm-title" }, about.title));
  root.append(stage, panel);
  el.replaceChildren(root);
  return parts;
}

function make(name, attributes, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

/** Let a slider say, to eyes and to screen readers, what its value means. */
function tell(slider, text) {
  slider.setAttribute("aria-valuetext", text);
  slider.closest(".pm-control").querySelector("output").textContent = text;
}

async function copy(element, status) {
  try {
    await navigator.clipboard.writeText(element.textContent);
    status.textContent = "copied";
  } catch {
    // Pages without a secure address have no clipboard: the text is marked, to be copied by hand.
    element.closest("details").open = true;
    getSelection().selectAllChildren(element);
    status.textContent = "press Ctrl-C";
  }
  setTimeout(() => (status.textContent = ""), 2000);
}

/** The index of the value that a slider shows for another one; they are even in 1/value. */
function nearest(values, value) {
  const of = (one) => (one === "inf" ? 0 : 1 / Number(one));
  const signed = values.some((one) => one !== "inf" && Number(one) <= 0);
  const at = signed ? Number : of;
  const apart = values.map((one) => Math.abs(at(one) - at(value)));
  return apart.indexOf(Math.min(...apart));
}

function stops(value) {
  return value === 0 ? "as it is" : `${value > 0 ? "+" : "−"}${Math.abs(value)} stops`;
}

function clamp(value, most) {
  return Math.min(Math.max(value, 0), most);
}

export default { render };
