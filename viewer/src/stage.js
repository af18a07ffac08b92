// The canvas with its scene: drawn when something changes, never otherwise.
import {
  Color, ColorManagement, Group, LinearSRGBColorSpace, OrthographicCamera, PerspectiveCamera, Quaternion, Scene,
  Vector3, WebGLRenderer,
} from "three";

export const FOV_DEG = 60;
const LOOK_MS = 4; // how often it is asked whether a picture is there
const LONGEST_MS = 5000; // after which that is given up

/** Whether a processor draws, not a graphics card, as far as the browser tells: smooth edges cost it most. */
function inSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const told = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = told ? gl.getParameter(told.UNMASKED_RENDERER_WEBGL) : gl?.getParameter(gl.RENDERER) ?? "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

export class Stage {
  /** `up`: the direction in the world of the result that points up on the screen. */
  constructor(canvas, up) {
    ColorManagement.enabled = false; // colours are shown as the images have them
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({ canvas, antialias: !inSoftware(), powerPreference: "high-performance" });
    this.sharpness = 1; // pixels of the picture to those of the screen, along a side
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.scene = new Scene();
    this.world = new Group(); // holds everything in the coordinates of the result
    this.world.quaternion.setFromUnitVectors(new Vector3(...up).normalize(), new Vector3(0, 1, 0));
    this.world.updateMatrixWorld(true);
    this.scene.add(this.world);
    this.perspective = new PerspectiveCamera(FOV_DEG, 1, 0.01, 1000);
    this.orthographic = new OrthographicCamera(-1, 1, 1, -1, 0.01, 1000);
    this.camera = this.perspective;
    this.before = []; // called before each picture
    this.after = []; // and after it
    this.finished = []; // called with the milliseconds that a picture took, when it is there
    this.scheduled = false;
    this.fence = null;
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.dress());
    this.dress();
    this.resize();
  }

  dress() {
    this.scene.background = new Color(getComputedStyle(this.canvas).getPropertyValue("--stage").trim());
    this.invalidate();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    this.width = width;
    this.height = height;
    this.renderer.setPixelRatio(this.sharpness * Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.perspective.aspect = width / height;
    this.perspective.updateProjectionMatrix();
    const half = (this.orthographic.top - this.orthographic.bottom) / 2;
    this.spread(half);
    this.invalidate();
  }

  /** Fewer pixels for a machine that draws slowly; 1: all. */
  sharpen(sharpness) {
    if (sharpness === this.sharpness) return;
    this.sharpness = sharpness;
    this.resize();
  }

  /** The orthographic camera shows `half` metres above and below its middle. */
  spread(half) {
    const wide = half * (this.width ?? 1) / (this.height ?? 1);
    Object.assign(this.orthographic, { left: -wide, right: wide, top: half, bottom: -half });
    this.orthographic.updateProjectionMatrix();
  }

  /** Metres that one pixel covers at a distance from the camera. */
  metresPerPixel(distance) {
    if (this.camera === this.orthographic)
      return (this.camera.top - this.camera.bottom) / this.camera.zoom / this.height;
    return (2 * Math.tan((FOV_DEG * Math.PI) / 360) * distance) / this.height;
  }

  /** Whether a picture is asked for, or being drawn. */
  get pending() {
    return this.scheduled || this.fence !== null;
  }

  /** Asks for a picture. None is begun before the last one is there: pictures in a queue would lag behind the hand. */
  invalidate() {
    if (this.scheduled) return;
    this.scheduled = true;
    if (this.fence === null) this.next();
  }

  next() {
    requestAnimationFrame(time => {
      this.draw(time);
      this.follow(performance.now());
    });
  }

  draw(time) {
    this.scheduled = false;
    this.began = performance.now();
    for (const prepare of this.before) prepare(time);
    this.camera.updateMatrixWorld();
    this.renderer.render(this.scene, this.camera);
    for (const follow of this.after) follow(time);
  }

  /** Waits, without holding anything up, until the picture that was just begun is there. */
  follow(since) {
    const gl = this.renderer.getContext();
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    this.fence = fence;
    const look = () => {
      const lost = !fence || gl.isContextLost() || performance.now() - since > LONGEST_MS;
      if (!lost && gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED) return setTimeout(look, LOOK_MS);
      if (fence) gl.deleteSync(fence);
      this.fence = null;
      const took = performance.now() - this.began;
      for (const told of this.finished) told(took);
      if (this.scheduled) this.next();
    };
    setTimeout(look, 0);
  }

  /** A position of the result's world in that of the screen (y up). */
  toScene(position) {
    return new Vector3(...position).applyMatrix4(this.world.matrixWorld);
  }

  /** [x, y, depth] on the canvas in CSS pixels; depth beyond 1 is behind the camera or too far. */
  project(position) {
    const p = this.toScene(position).project(this.camera);
    return [((p.x + 1) / 2) * this.width, ((1 - p.y) / 2) * this.height, p.z];
  }

  /** Up in the world of the result. */
  get up() {
    return new Vector3(0, 1, 0).applyQuaternion(new Quaternion().copy(this.world.quaternion).invert());
  }
}
