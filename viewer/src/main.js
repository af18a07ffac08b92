// The viewer of a page: finds its elements, reads what there is to show, and joins the parts to each other.
import { Beside } from "./beside.js";
import { bounds, heading } from "./bounds.js";
import { Cameras } from "./cameras.js";
import { OTHER, TRUTH, recordingColor } from "./colors.js";
import { Edges } from "./edges.js";
import { Ellipsoids } from "./ellipsoids.js";
import { Frames } from "./frames.js";
import { keyboard } from "./keyboard.js";
import { layerBoxes } from "./layers.js";
import { Labels } from "./labels.js";
import { drawLegend } from "./legend.js";
import { readLink, writeLink } from "./link.js";
import { Measure } from "./measure.js";
import { openModel } from "./model.js";
import { Navigation } from "./navigate.js";
import { Pace } from "./pace.js";
import { Panel } from "./panel.js";
import { edgeAt, frameAt, pointAt } from "./picking.js";
import { Selection } from "./selection.js";
import { Slab } from "./slab.js";
import { openSource } from "./source.js";
import { Stage } from "./stage.js";
import { Timeline } from "./timeline.js";
import { fromBase64, unpackMatches } from "./unpack.js";

const LINK_MS = 250;
const LOADING = "The model is being loaded.";
const NO_POSE = "No frame has a pose. Step through the frames to see why.";
const CLICK_PX = 5; // a pointer that moved farther turned the view

const part = name => document.getElementById(`v-${name}`);

const say = words => { part("said").textContent = words; };

async function start(viewer) {
  const source = await openSource();
  const { scene } = source;
  part("nothing").textContent = LOADING;
  const frames = new Frames(scene.frames, scene.camera, scene.recordings);
  viewer.classList.toggle("v-alone", !frames.count); // a model without frames
  const stage = new Stage(part("canvas"), scene.up);
  const pace = new Pace(stage);
  const slab = new Slab(stage);
  const model = await openModel(source, stage, pace, slab);
  const box = bounds(stage, frames, model);
  slab.reach(box.low, box.high);
  const navigation = new Navigation(stage, pace, box, heading(stage, frames));
  const cameras = new Cameras(frames, stage);
  const edges = new Edges(scene.edges, await unpackMatches(fromBase64(scene.edges.packed)), frames, stage);
  const ellipsoids = new Ellipsoids(frames, stage);
  new Labels(stage.canvas.parentElement, frames, stage);
  const ruler = new Measure(stage, part("distance"));
  const selection = new Selection();
  const choose = { frame: k => selection.set(k, null), edge: e => selection.set(null, e) };
  const panel = new Panel(part("details"), frames, edges, source, choose);
  const timeline = new Timeline(
    { slider: part("time"), previous: part("previous"), next: part("next"), play: part("play"), label: part("when") },
    frames, choose.frame);

  const layers = [
    { words: "model", objects: [model?.object], on: true },
    ...(frames.count ? [{ words: cameras.words, objects: [cameras.object], on: true },
      { words: "path", objects: [cameras.path], on: true }] : []),
    ...(ellipsoids.known ? [{ words: `uncertainty (${ellipsoids.words})`, objects: [ellipsoids.object], on: false }] : []),
    ...(scene.truth ? [{ words: "ground truth", objects: [new Beside(scene.truth, frames, TRUTH, stage).object], on: true }] : []),
    ...(scene.other ? [{ words: scene.other.name, objects: [new Beside(scene.other.positions, frames, OTHER, stage).object], on: true }] : []),
  ].filter(layer => layer.objects[0]);
  layerBoxes(part("layers"), layers, stage);

  let pathRange = null;
  const measures = frames.measures();
  const measure = () => measures.find(({ key }) => key === part("path-color").value) ?? null;
  const legend = () => {
    const chosen = measure();
    const rows = edges.legend();
    drawLegend(part("legend"), [
      ...(chosen?.key === "recording" ? [{ title: "", rows: frames.recordings.map(({ name }, r) => [name, recordingColor(r)]) }]
        : chosen ? [{ title: chosen.words, ramp: pathRange, unit: chosen.unit }] : []),
      ...(edges.shown.length ? [rows ? { title: "edges", rows } : { title: "residual", ramp: [0, edges.worst], unit: "deg" }] : []),
    ]);
  };

  for (const { key, words } of measures) part("path-color").add(new Option(words, key));
  part("path-color").addEventListener("change", () => {
    pathRange = cameras.colorBy(measure());
    legend();
  });
  if (scene.recordings) { // of a map: which is which, and what joins them
    part("path-color").value = "recording";
    cameras.colorBy(measure());
    part("edge-mode").add(new Option("between recordings", "between"));
    part("edge-mode").value = "between";
  }
  if (scene.edges.origins) part("edge-color").add(new Option("which result", "origin"));
  const showEdges = () => {
    edges.mode = part("edge-mode").value;
    edges.by = part("edge-color").value;
    edges.build();
    legend();
  };
  for (const name of ["edge-mode", "edge-color"]) part(name).addEventListener("change", showEdges);

  let linking = null;
  selection.followers.push(({ frame, edge }) => {
    pace.moved(); // whoever steps through the frames must not wait for the whole model
    cameras.select(frame);
    edges.frame = frame;
    edges.select(edge);
    if (edges.mode === "selected") showEdges();
    if (frame !== null) {
      panel.frame(frame);
      timeline.show(frame);
      say(`Frame ${frames.name(frame)} selected. ${panel.read()}`);
    } else if (edge !== null) {
      panel.edge(edge);
      say(`Edge ${edges.name(edge)} selected, ${panel.line(edge)}.`);
    } else {
      panel.nothing();
      timeline.show(null);
      say("Nothing selected.");
    }
    // Once one stays: browsers forbid an address that changes with every picture.
    clearTimeout(linking);
    linking = setTimeout(() => writeLink({ frame, edge: edge === null ? null : [scene.edges.i[edge], scene.edges.j[edge]] }), LINK_MS);
  });

  const modes = { orbit: () => navigation.use("orbit"), walk: () => navigation.use("walk"), plan: () => navigation.floorPlan() };
  const use = mode => {
    modes[mode]();
    slab.plan(mode === "plan");
    for (const name of Object.keys(modes)) part(name).setAttribute("aria-pressed", name === mode);
    if (navigation.used) say({ orbit: "Turning around the model.", walk: "On foot.", plan: "Floor plan." }[mode]);
    navigation.used = true;
  };
  const view = {
    overview: () => { use("orbit"); navigation.overview(); },
    top: () => { use("orbit"); navigation.top(); },
    through: () => {
      if (selection.frame === null || !frames.position(selection.frame)) return say("Select a camera first.");
      navigation.through(frames.position(selection.frame), frames.turn(selection.frame), 2 * cameras.size);
      use(navigation.mode);
    },
  };
  for (const name of Object.keys(modes)) part(name).addEventListener("click", () => use(name));
  for (const name of Object.keys(view)) part(name).addEventListener("click", view[name]);

  slab.controls({ box: part("slab"), from: part("slab-from"), to: part("slab-to"), label: part("slab-words") });

  const measuring = on => {
    part("measure").setAttribute("aria-pressed", on);
    stage.canvas.parentElement.classList.toggle("measuring", on);
    if (!on) ruler.clear();
    say(on ? "Measuring: click two points of the model, or press Enter with the cross on each." : "");
  };
  const isMeasuring = () => part("measure").getAttribute("aria-pressed") === "true";
  part("measure").addEventListener("click", () => measuring(!isMeasuring()));

  const pick = (x, y) => {
    if (isMeasuring()) {
      const point = model?.forEach ? pointAt(stage, model, slab.holds, x, y) : null;
      return say(point ? ruler.add(point) : "There is no point of the model here.");
    }
    const frame = frameAt(stage, frames, x, y);
    const edge = frame === null ? edgeAt(stage, edges, x, y) : null;
    selection.set(frame, edge);
  };
  let down = null;
  stage.canvas.addEventListener("pointerdown", event => { down = [event.offsetX, event.offsetY]; });
  stage.canvas.addEventListener("pointerup", event => {
    const { offsetX: x, offsetY: y } = event;
    if (down && Math.hypot(x - down[0], y - down[1]) < CLICK_PX) pick(x, y);
    down = null;
  });

  part("link").addEventListener("click", async () => {
    clearTimeout(linking);
    const edge = selection.edge === null ? null : [scene.edges.i[selection.edge], scene.edges.j[selection.edge]];
    const address = writeLink({ frame: selection.frame, edge, eye: navigation.place });
    try {
      await navigator.clipboard.writeText(address);
      say("The address of this view is copied.");
    } catch {
      say("The address bar holds the address of this view.");
    }
  });
  part("full").addEventListener("click", () =>
    (document.fullscreenElement ? document.exitFullscreen() : viewer.requestFullscreen?.()));
  keyboard(stage.canvas, navigation, {
    ...view, use, measure: () => measuring(!isMeasuring()),
    pick: () => pick(stage.width / 2, stage.height / 2),
    step: by => timeline.step(by), play: () => timeline.toggle(),
    clear: () => { measuring(false); selection.set(null, null); },
  });

  const follow = () => {
    const link = readLink();
    const edge = link.edge && edges.find(...link.edge);
    if (link.frame !== null && link.frame < frames.count) choose.frame(link.frame);
    else if (edge !== null && edge !== undefined) choose.edge(edge);
    if (link.eye) navigation.place = link.eye;
  };
  addEventListener("hashchange", follow);
  panel.nothing();
  use("orbit");
  navigation.overview();
  showEdges();
  const empty = !frames.placed.length && frames.count > 0;
  part("nothing").textContent = empty ? NO_POSE : "";
  if (empty) say(NO_POSE);
  follow();
  viewer.dataset.ready = "true";
  // For tests, and for a look from the console.
  viewer.view = { stage, frames, edges, selection, navigation, pace, model, ruler };
}

const viewer = document.getElementById("viewer");
if (viewer)
  start(viewer).catch(error => {
    part("nothing").textContent = "";
    part("said").textContent = `The 3D view cannot be shown here: ${error.message}`;
    viewer.dataset.ready = "failed";
  });
