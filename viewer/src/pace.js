// How many points can be drawn: learnt from the time that each picture took, fewer while the view moves, more at rest.
const SMOOTH_MS = 40; // a picture, while something moves
const PATIENT_MS = 800; // a picture, when nothing does
const LONGEST_MS = 6000; // a picture, when nothing has moved for long
const LONG_MS = 1500;
const REST_MS = 200; // without a motion: nothing moves any more
const FIRST = 100000; // before anything is known of the machine
const FEWEST = 15000;
const BLURRED = 0.5; // of the pixels along a side, while a machine moves that is slow even with the fewest points
const GROWTH = 4; // of the points from one picture at rest to the next, which takes about twice as long

export class Pace {
  constructor(stage) {
    Object.assign(this, { stage, moving: false, affordable: FIRST, atRest: FIRST, shown: 0, total: 0, blurred: false });
    stage.finished.push(took => this.learn(took));
  }

  /** Said by whatever moves the view. */
  moved() {
    this.moving = true;
    this.stage.sharpen(this.blurred ? BLURRED : 1);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.rest(), REST_MS);
    this.stage.invalidate();
  }

  rest() {
    // A slow picture is no rest: it begins when the last one is there.
    if (this.stage.pending) {
      this.timer = setTimeout(() => this.rest(), REST_MS);
      return;
    }
    this.moving = false;
    this.atRest = this.affordable;
    this.stage.sharpen(1);
    this.stage.invalidate();
  }

  refine() {
    this.atRest *= GROWTH;
    this.stage.invalidate();
  }

  budget() {
    return Math.round(this.moving ? this.affordable : this.atRest);
  }

  drawn(shown, total) {
    this.shown = shown;
    this.total = total;
  }

  /** `took`: milliseconds from the beginning of a picture until it was there. */
  learn(took) {
    if (!this.moving) {
      // Step by step, so that one who moves again never waits for long.
      if (this.shown < this.atRest || this.atRest >= this.total || took * 2 > LONGEST_MS) return;
      clearTimeout(this.timer);
      if (took * 2 < PATIENT_MS) this.refine();
      else this.timer = setTimeout(() => this.refine(), LONG_MS);
      return;
    }
    // Slowly up, fast down; time that something else took is no reason to draw nothing.
    const change = Math.min(Math.max(SMOOTH_MS / Math.max(took, 1), 0.5), 1.15);
    if (this.affordable <= FEWEST && took > 2 * SMOOTH_MS) this.blurred = true;
    if (change < 1 || this.shown >= this.affordable) this.affordable = Math.max(FEWEST, this.affordable * change);
  }
}
