// The model of a page, in whatever form it comes.
import { CoarseFirst } from "./points.js";
import { openMesh } from "./mesh.js";
import { Tiles } from "./tiles.js";

/** { object, count, forEach } of the model; null without one. */
export async function openModel(source, stage, pace, slab) {
  const meta = source.model;
  if (!meta) return null;
  if (meta.kind === "mesh") return openMesh(source, stage, slab);
  if (meta.kind === "tiles") return Tiles.open(source, stage, pace, slab);
  const model = new CoarseFirst(await source.points(), meta, stage, pace, slab);
  stage.world.add(model.object);
  return model;
}
