// Stepping and playing through the frames.
const PLAY_MS = 100; // a frame, at least: slow recordings of a few frames are not rushed

export class Timeline {
  /** `elements`: { slider, previous, next, play, label }; `choose(k)` selects a frame. */
  constructor(elements, frames, choose) {
    Object.assign(this, { ...elements, frames, choose, current: null });
    this.slider.max = Math.max(frames.count - 1, 0);
    this.slider.value = 0;
    this.slider.addEventListener("input", () => this.slide());
    this.previous.addEventListener("click", () => this.step(-1));
    this.next.addEventListener("click", () => this.step(1));
    this.play.addEventListener("click", () => this.toggle());
    for (const control of [this.slider, this.previous, this.next, this.play]) control.disabled = frames.count < 2;
    this.show(null);
  }

  /** One frame a picture, however fast the slider moves. */
  slide() {
    if (this.sliding) return;
    this.sliding = true;
    requestAnimationFrame(() => {
      this.sliding = false;
      this.choose(Number(this.slider.value));
    });
  }

  step(by) {
    if (!this.frames.count) return;
    const next = this.current === null ? 0 : this.current + by;
    this.choose(Math.min(Math.max(next, 0), this.frames.count - 1));
  }

  toggle() {
    if (this.timer) this.stop();
    else if (this.frames.count > 1) {
      if (this.current === null || this.current === this.frames.count - 1) this.choose(0);
      this.timer = setInterval(() => (this.current < this.frames.count - 1 ? this.step(1) : this.stop()), PLAY_MS);
    }
    this.play.setAttribute("aria-pressed", Boolean(this.timer));
  }

  stop() {
    clearInterval(this.timer);
    this.timer = null;
    this.play.setAttribute("aria-pressed", false);
  }

  show(k) {
    this.current = k;
    const { columns, count } = this.frames;
    if (k !== null) this.slider.value = k;
    const words = k === null ? `${count} frames` : `frame ${this.frames.name(k)}${this.frames.recordings.length > 1 ? "" : ` of ${count}`}, ${columns.seconds[k].toFixed(2)} s`;
    this.label.textContent = words;
    this.slider.setAttribute("aria-valuetext", words);
  }
}
