// Keys while the canvas has the focus. Tab and all keys with Ctrl, Alt or Cmd are left to the browser.
export function keyboard(canvas, navigation, act) {
  const actions = {
    Home: act.overview, t: act.top, f: () => act.use("plan"), o: () => act.use("orbit"), g: () => act.use("walk"),
    c: act.through, m: act.measure, Enter: act.pick, Escape: act.clear, " ": act.play,
    ",": () => act.step(-1), ".": () => act.step(1), PageUp: () => act.step(-10), PageDown: () => act.step(10),
  };
  canvas.addEventListener("keydown", event => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const walking = navigation.mode === "walk" && "wasdqe".includes(event.key.toLowerCase());
    const action = walking ? null : actions[event.key] ?? actions[event.key.toLowerCase()];
    if (action) action();
    else if (!navigation.key(event)) return;
    event.preventDefault();
  });
  canvas.addEventListener("keyup", event => navigation.release(event));
}
