// Moving through the model: around a point, on foot, and over its floor plan; by pointer, touch and keyboard.
import { Euler, MOUSE, Quaternion, TOUCH, Vector3 } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { FOV_DEG } from "./stage.js";

const TURN = Math.PI / 36; // a press of an arrow key
const SECONDS_ACROSS = 6; // on foot, from one side of the model to the other
const LONGEST_FRAME_MS = 100; // of a machine that draws slowly
const MARGIN = 1.08; // around the model in the picture
const UP = new Vector3(0, 1, 0);

export class Navigation {
  /** `box`: { centre, radius } of the model in the scene (y up); `heading`: where the cameras look, seen from above. */
  constructor(stage, pace, box, heading) {
    Object.assign(this, { stage, pace, box, heading });
    this.mode = "orbit";
    this.held = new Set();
    this.orbit = this.controls(stage.perspective);
    this.plan = this.controls(stage.orthographic);
    this.plan.enableRotate = false;
    this.plan.screenSpacePanning = true;
    this.plan.mouseButtons = { LEFT: MOUSE.PAN, MIDDLE: MOUSE.DOLLY, RIGHT: MOUSE.PAN };
    this.plan.touches = { ONE: TOUCH.PAN, TWO: TOUCH.DOLLY_PAN };
    this.listen(stage.canvas);
    this.overview();
  }

  controls(camera) {
    const controls = new OrbitControls(camera, this.stage.canvas);
    controls.addEventListener("change", () => this.pace.moved());
    controls.zoomToCursor = true;
    // The wheel scrolls the page until the view has the focus.
    controls.enableZoom = false;
    this.stage.canvas.addEventListener("focus", () => { controls.enableZoom = true; });
    this.stage.canvas.addEventListener("blur", () => { controls.enableZoom = false; });
    controls.enabled = false;
    return controls;
  }

  use(mode) {
    const { stage } = this;
    if (mode === "walk" && this.mode === "plan") this.overview();
    this.mode = mode;
    stage.camera = mode === "plan" ? stage.orthographic : stage.perspective;
    this.orbit.enabled = mode === "orbit";
    this.plan.enabled = mode === "plan";
    if (mode === "orbit") {
      // What one turns around lies in front of the eye, not where it was before the walk.
      const ahead = stage.perspective.getWorldDirection(new Vector3());
      this.orbit.target.copy(stage.perspective.position).addScaledVector(ahead, this.distance ?? this.box.radius);
      this.orbit.update();
    }
    this.pace.moved();
  }

  /** All of the model, from behind the cameras and a little above. */
  overview() {
    this.look(new Vector3().copy(this.heading).multiplyScalar(-1).add(new Vector3(0, 0.7, 0)));
  }

  top() {
    this.look(new Vector3().copy(this.heading).multiplyScalar(-0.001).add(UP));
  }

  /** All of the model, seen from a direction. */
  look(from) {
    const { box, stage } = this;
    this.distance = this.fitting(from.normalize());
    stage.perspective.position.copy(box.centre).addScaledVector(from, this.distance);
    stage.perspective.lookAt(box.centre);
    this.orbit.target.copy(box.centre);
    this.limits();
    if (this.mode !== "orbit") this.use("orbit");
    this.orbit.enabled = true;
    this.orbit.update();
    this.pace.moved();
  }

  /** From how far in a direction (of length 1) every corner of the model's box is in the picture. */
  fitting(from) {
    const { box: { centre, least, most, radius }, stage } = this;
    const right = new Vector3().crossVectors(UP, from).normalize(), up = new Vector3().crossVectors(from, right);
    const tall = Math.tan((FOV_DEG * Math.PI) / 360), wide = tall * (stage.width ?? 1) / (stage.height ?? 1);
    let far = 0.6 * radius;
    for (let corner = 0; corner < 8; corner++) {
      const p = new Vector3(...["x", "y", "z"].map((axis, k) => (corner >> k & 1 ? most : least)[axis])).sub(centre);
      const across = Math.max(Math.abs(p.dot(right)) / wide, Math.abs(p.dot(up)) / tall);
      far = Math.max(far, p.dot(from) + MARGIN * across);
    }
    return far;
  }

  limits() {
    const { stage, box } = this;
    stage.perspective.near = box.radius / 1000;
    stage.perspective.far = 40 * box.radius;
    stage.perspective.updateProjectionMatrix();
  }

  floorPlan() {
    const { stage, box } = this;
    const camera = stage.orthographic;
    stage.spread(1.05 * box.radius / Math.min(1, stage.width / stage.height));
    camera.zoom = 1;
    camera.near = 0.01 * box.radius;
    camera.far = 20 * box.radius;
    camera.position.copy(box.centre).addScaledVector(UP, 5 * box.radius);
    camera.up.copy(this.heading);
    camera.lookAt(box.centre);
    camera.updateProjectionMatrix();
    this.plan.target.copy(box.centre);
    this.use("plan");
    this.plan.update();
  }

  /** Looks through a camera, from a little behind it. */
  through(position, turn, back) {
    const eye = this.stage.toScene(position);
    const world = this.stage.world.quaternion.clone().multiply(turn);
    const ahead = new Vector3(0, 0, 1).applyQuaternion(world);
    this.distance = Math.max(this.box.radius / 4, 3 * back);
    this.stage.perspective.position.copy(eye).addScaledVector(ahead, -back);
    this.stage.perspective.lookAt(eye.add(ahead));
    this.use(this.mode === "walk" ? "walk" : "orbit");
  }

  /** The eye, and what it looks at: six numbers for a link. */
  get place() {
    const { position } = this.stage.perspective;
    const ahead = this.stage.perspective.getWorldDirection(new Vector3()).multiplyScalar(this.distance).add(position);
    return [...position, ...ahead];
  }

  set place(numbers) {
    this.stage.perspective.position.set(...numbers.slice(0, 3));
    const target = new Vector3(...numbers.slice(3));
    this.stage.perspective.lookAt(target);
    this.distance = target.distanceTo(this.stage.perspective.position);
    this.use("orbit");
  }

  listen(canvas) {
    canvas.addEventListener("pointermove", event => {
      if (this.mode !== "walk" || !event.buttons) return;
      this.turn(-event.movementX * 0.004, -event.movementY * 0.004);
    });
    canvas.addEventListener("blur", () => this.held.clear());
    canvas.addEventListener("wheel", event => {
      if (this.mode !== "walk" || document.activeElement !== canvas) return;
      event.preventDefault();
      this.step(0, 0, Math.sign(event.deltaY) * this.box.radius / 40);
    }, { passive: false });
  }

  /** Turns the eye, on foot. */
  turn(yaw, pitch) {
    const camera = this.stage.perspective;
    const euler = new Euler().setFromQuaternion(camera.quaternion, "YXZ");
    euler.y += yaw;
    euler.x = Math.min(Math.max(euler.x + pitch, -1.5), 1.5);
    euler.z = 0;
    camera.quaternion.setFromEuler(euler);
    this.pace.moved();
  }

  /** Moves the eye to the right, up and back, with its feet level. */
  step(right, up, back) {
    const camera = this.stage.perspective;
    const level = new Quaternion().setFromEuler(
      new Euler(0, new Euler().setFromQuaternion(camera.quaternion, "YXZ").y, 0));
    camera.position.add(new Vector3(right, 0, back).applyQuaternion(level)).addScaledVector(UP, up);
    this.pace.moved();
  }

  /** Whether a key moves the view; then it has. */
  key(event) {
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const zooms = { "+": 0.87, "=": 0.87, "-": 1.15, _: 1.15 };
    if (this.mode === "walk") return this.walkKey(event, arrows);
    const controls = this.mode === "plan" ? this.plan : this.orbit;
    if (arrows[event.key]) {
      const [x, y] = arrows[event.key];
      if (event.shiftKey || this.mode === "plan") this.pan(controls, x, y);
      else this.around(x * TURN, y * TURN);
    } else if (zooms[event.key]) {
      if (this.mode === "plan") {
        this.stage.orthographic.zoom /= zooms[event.key];
        this.stage.orthographic.updateProjectionMatrix();
      } else {
        const offset = this.stage.perspective.position.clone().sub(controls.target).multiplyScalar(zooms[event.key]);
        this.stage.perspective.position.copy(controls.target).add(offset);
      }
    } else return false;
    controls.update();
    this.pace.moved();
    return true;
  }

  around(yaw, pitch) {
    const camera = this.stage.perspective, { target } = this.orbit;
    const offset = camera.position.clone().sub(target);
    const flat = Math.hypot(offset.x, offset.z), length = offset.length();
    const height = Math.min(Math.max(Math.atan2(offset.y, flat) + pitch, -1.55), 1.55);
    const turned = Math.atan2(offset.x, offset.z) + yaw;
    offset.set(Math.sin(turned) * Math.cos(height), Math.sin(height), Math.cos(turned) * Math.cos(height));
    camera.position.copy(target).addScaledVector(offset, length);
    camera.lookAt(target);
  }

  pan(controls, x, y) {
    const camera = controls.object;
    const far = this.stage.metresPerPixel(camera.position.distanceTo(controls.target)) * 40;
    const move = new Vector3(x * far, y * far, 0).applyQuaternion(camera.quaternion);
    camera.position.add(move);
    controls.target.add(move);
  }

  walkKey(event, arrows) {
    const steps = { w: [0, 0, -1], s: [0, 0, 1], a: [-1, 0, 0], d: [1, 0, 0], e: [0, 1, 0], q: [0, -1, 0] };
    const key = event.key.toLowerCase();
    if (arrows[event.key]) {
      const [x, y] = arrows[event.key];
      this.turn(-x * TURN, y * TURN);
    } else if (steps[key]) {
      // A key that is only tapped may be up again before the next frame is drawn.
      if (!this.held.has(key)) this.step(...steps[key].map(v => v * this.walked(LONGEST_FRAME_MS)));
      this.held.add(key);
      this.go(steps);
    } else return false;
    return true;
  }

  release(event) {
    this.held.delete(event.key.toLowerCase());
  }

  /** How far one walks in some milliseconds. */
  walked(ms) {
    return (ms / 1000) * (this.box.radius / SECONDS_ACROSS) * 2;
  }

  /** Walks as long as keys are held. */
  go(steps) {
    if (this.going) return;
    let last = performance.now();
    const stride = now => {
      if (!this.held.size || this.mode !== "walk") {
        this.going = false;
        return;
      }
      const far = this.walked(Math.min(now - last, LONGEST_FRAME_MS));
      last = now;
      for (const key of this.held) this.step(...steps[key].map(v => v * far));
      requestAnimationFrame(stride);
    };
    this.going = true;
    requestAnimationFrame(stride);
  }
}
