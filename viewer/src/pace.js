// How many points can be drawn: learnt from the time between pictures while the view moves.
const SMOOTH_MS = 33; // a picture, while something moves
const PATIENT_MS = 400; // a picture, when nothing does
const REST_MS = 200; // without a picture: nothing moves any more
const FEWEST = 20000;

export class Pace {
  constructor(stage) {
    this.stage = stage;
    this.moving = false;
    this.affordable = 400000;
    this.last = null;
    this.shown = 0;
    stage.after.push(time => this.learn(time));
  }

  /** Said by whatever moves the view. */
  moved() {
    this.moving = true;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.rest(), REST_MS);
    this.stage.invalidate();
  }

  rest() {
    this.moving = false;
    this.last = null;
    this.stage.invalidate();
  }

  budget() {
    return Math.round(this.moving ? this.affordable : (this.affordable * PATIENT_MS) / SMOOTH_MS);
  }

  drawn(shown, total) {
    this.shown = shown;
    this.total = total;
  }

  learn(time) {
    if (!this.moving) return;
    if (this.last !== null) {
      const took = Math.max(time - this.last, 1);
      // Slowly up, fast down; time that something else took is no reason to draw nothing.
      const change = Math.min(Math.max(SMOOTH_MS / took, 0.6), 1.15);
      if (change < 1 || this.shown >= this.affordable) this.affordable = Math.max(FEWEST, this.affordable * change);
    }
    this.last = time;
  }
}
