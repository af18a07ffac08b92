// Where the page has its data from: from itself, or from the program that serves it.
import { fromBase64, unpackPoints } from "./unpack.js";

/** A page that carries everything, and works from disk. */
class Carried {
  constructor() {
    this.scene = this.json("v-scene");
    this.model = this.json("v-model");
    this.pictures = this.json("v-pictures") ?? []; // larger ones first
    this.numbers = this.pictures.flatMap(({ files }) => Object.keys(files).map(Number)).sort((a, b) => a - b);
  }

  json(id) {
    const element = document.getElementById(id);
    return element ? JSON.parse(element.textContent) : null;
  }

  async points() {
    return unpackPoints(fromBase64(document.getElementById("v-points").textContent));
  }

  /** The image of the frame, or of the carried frame nearest to it: { frame, src }; null without any. */
  picture(k) {
    if (!this.numbers.length) return null;
    const frame = this.numbers.reduce((best, n) => (Math.abs(n - k) < Math.abs(best - k) ? n : best));
    const { head, files } = this.pictures.find(size => frame in size.files);
    return { frame, src: `data:image/jpeg;base64,${head}${files[frame]}` };
  }
}

/** A page of `miniloop view`: the address of the page ends in the token that every request repeats. */
class Served {
  async get(path) {
    const answer = await fetch(path);
    if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
    return answer;
  }

  async open() {
    this.scene = await (await this.get("scene.json")).json();
    this.model = await (await this.get("model.json")).json();
    return this;
  }

  async points(begin, end) {
    return unpackPoints(new Uint8Array(await (await this.get(`points/${begin}-${end}`)).arrayBuffer()));
  }

  picture(k) {
    return this.scene.images ? { frame: k, src: `frame/${k}.jpg` } : null;
  }
}

export const openSource = async () =>
  document.getElementById("v-scene") ? new Carried() : new Served().open();
