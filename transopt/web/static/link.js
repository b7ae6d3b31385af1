// The connection to the server: messages in JSON and in binary frames. A lost connection is opened again.

const RETRY_MS = 1000;

export class Link {
  // `received(message, arrays)` gets every message, `connection(connected)` every change of the connection.
  constructor(received, connection) {
    this.received = received;
    this.connection = connection;
    this.scene = 0; // number of the scene that is shown; the server answers no request about one before it
    this.open();
  }

  open() {
    const place = new URL("window", location.href);
    place.protocol = "ws:";
    this.socket = new WebSocket(place);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => this.connection(true);
    this.socket.onmessage = (event) => this.take(event.data);
    this.socket.onclose = () => {
      this.connection(false);
      setTimeout(() => this.open(), RETRY_MS);
    };
  }

  take(data) {
    if (typeof data === "string") {
      this.received(JSON.parse(data), {});
      return;
    }
    const length = new DataView(data).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    const arrays = {};
    let at = 4 + length;
    for (const [name, size] of head.arrays || []) {
      arrays[name] = new Float32Array(data, at, size);
      at += 4 * size;
    }
    if (!head.arrays) arrays.body = new Uint8Array(data, at);
    this.received(head, arrays);
  }

  get connected() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  say(message) {
    if (this.connected) this.socket.send(JSON.stringify({ ...message, scene: this.scene }));
  }

  async sendFiles(files, message) {
    const bodies = await Promise.all(files.map((file) => file.arrayBuffer()));
    const listed = files.map((file, j) => [file.name, bodies[j].byteLength]);
    const head = new TextEncoder().encode(JSON.stringify({ ...message, files: listed }));
    const length = new DataView(new ArrayBuffer(4));
    length.setUint32(0, head.byteLength, true);
    if (this.connected) this.socket.send(new Blob([length.buffer, head, ...bodies]));
  }
}
