// The page of `potmesil live`: the widget's front end, with a model that talks over a WebSocket.

import viewer from "./viewer.js";

/** What anywidget's model is to the front end, as far as it is used: get, send, on and off. */
class Model {
  constructor(socket, about) {
    this.socket = socket;
    this.values = { about };
    this.listeners = new Map();
  }

  get(name) {
    return this.values[name];
  }

  send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  on(event, listener) {
    if (!this.listeners.has(event)) this.listeners.set(event, new Set());
    this.listeners.get(event).add(listener);
  }

  off(event, listener) {
    this.listeners.get(event)?.delete(listener);
  }

  /** Takes a frame: the length of the message, the message, the picture. */
  receive(frame) {
    const length = new DataView(frame).getUint32(0, true);
    const message = JSON.parse(new TextDecoder().decode(new Uint8Array(frame, 4, length)));
    this.tell(message, [new DataView(frame, 4 + length)]);
  }

  tell(message, buffers) {
    for (const listener of this.listeners.get("msg:custom") ?? []) listener(message, buffers);
  }
}

const address = new URL("socket", document.baseURI);
address.protocol = "ws:";
const socket = new WebSocket(address);
socket.binaryType = "arraybuffer";
let model = null;

socket.addEventListener("message", ({ data }) => {
  if (typeof data === "string") {
    model = new Model(socket, JSON.parse(data).about);
    if (model.get("about").title) document.title = `${model.get("about").title} – potmesil live`;
    viewer.render({ model, el: document.getElementById("viewer") });
  } else {
    model.receive(data);
  }
});

socket.addEventListener("close", () => {
  const text = "potmesil live has ended; start it again for a new address";
  if (model) model.tell({ kind: "ended", text }, []);
  else document.getElementById("viewer").textContent = text;
});
