// A cloud too large for one piece: the tiles of an octree, fetched where one looks, coarse ones first.
import { Group, Vector3 } from "three";
import { quantised, spread } from "./points.js";

const LEAST_PX = 1.5; // points of a tile that would stand nearer than this on the screen are not fetched
const AT_ONCE = 3;
const MOST_POINTS = 6e6; // that are held; tiles not seen for longest are dropped
const GRID = 128; // points a side of a tile's cube

export class Tiles {
  static async open(source, stage, pace, slab) {
    const tiles = new Tiles(source, stage, pace, slab);
    await tiles.load(tiles.all[0]);
    return tiles;
  }

  constructor(source, stage, pace, slab) {
    Object.assign(this, { source, stage, pace, slab, meta: source.model });
    this.object = new Group();
    stage.world.add(this.object);
    this.count = this.meta.count;
    this.loading = 0;
    this.turn = 0;
    const { corner, side } = this.meta;
    this.all = this.meta.tiles.map(([depth, x, y, z, begin, end]) => {
      const size = side / 2 ** depth;
      const low = [x, y, z].map((cell, axis) => corner[axis] + size * cell);
      const centre = stage.toScene(low.map(v => v + size / 2));
      return { begin, end, size, centre, spacing: size / GRID, points: null, pending: false, seen: 0 };
    });
    stage.before.push(() => this.prepare());
  }

  get held() {
    return this.all.filter(tile => tile.points);
  }

  /** How far apart a tile's points stand on the screen (px), where it is in view; 0 elsewhere. */
  worth(tile) {
    const { camera } = this.stage, radius = tile.size * 0.87;
    const away = tile.centre.clone().sub(camera.position);
    const ahead = away.dot(camera.getWorldDirection(new Vector3()));
    if (ahead < -radius) return 0;
    const p = tile.centre.clone().project(camera);
    const reach = radius / this.stage.metresPerPixel(Math.max(ahead, 0.01)) / Math.min(this.stage.width, this.stage.height) * 2;
    if (ahead > radius && (Math.abs(p.x) > 1 + reach || Math.abs(p.y) > 1 + reach)) return 0;
    return tile.spacing / this.stage.metresPerPixel(Math.max(away.length() - radius, tile.size / 4));
  }

  prepare() {
    this.turn++;
    const seen = this.all.map(tile => [this.worth(tile), tile]).filter(([worth]) => worth >= LEAST_PX / 2)
      .sort((a, b) => b[0] - a[0]);
    let left = this.pace.budget(), finest = this.meta.side / GRID;
    for (const tile of this.held) tile.points.visible = false;
    for (const [, tile] of seen) {
      if (!tile.points || left <= 0) continue;
      tile.points.visible = true;
      tile.seen = this.turn;
      // Points of a tile are coarse first, too: a part of them is all of it, less dense.
      const all = tile.end - tile.begin;
      tile.drawn = Math.min(all, left);
      tile.points.geometry.setDrawRange(0, tile.drawn);
      left -= tile.drawn;
      finest = Math.min(finest, tile.spacing * Math.sqrt(all / tile.drawn));
    }
    // Among finer points, coarse ones are drawn as small as these, though not everywhere are there finer ones.
    for (const tile of this.held)
      if (tile.points.visible) {
        const own = tile.spacing * Math.sqrt((tile.end - tile.begin) / tile.drawn);
        spread(tile.points, Math.max(finest, own / 4), this.stage);
      }
    this.pace.drawn(this.pace.budget() - left, this.count);
    this.fetch(seen);
  }

  fetch(seen) {
    if (this.pace.moving) return;
    for (const [worth, tile] of seen) {
      if (this.loading >= AT_ONCE || worth < LEAST_PX) return;
      if (!tile.points && !tile.pending) this.load(tile).catch(() => { tile.pending = true; });
    }
  }

  async load(tile) {
    tile.pending = true;
    this.loading++;
    try {
      tile.arrays = await this.source.points(tile.begin, tile.end);
    } finally {
      this.loading--;
    }
    tile.pending = false;
    tile.points = quantised(tile.arrays, this.meta, this.slab.planes);
    tile.seen = this.turn;
    this.object.add(tile.points);
    this.drop();
    this.stage.invalidate();
  }

  /** Lets go of the tiles that were not seen for longest, where more is held than may be; never of the first. */
  drop() {
    let held = this.held.reduce((sum, tile) => sum + tile.end - tile.begin, 0);
    for (const tile of this.held.filter(t => t !== this.all[0]).sort((a, b) => a.seen - b.seen)) {
      if (held <= MOST_POINTS || tile.seen === this.turn) return;
      held -= tile.end - tile.begin;
      tile.points.removeFromParent();
      tile.points.geometry.dispose();
      tile.points.material.dispose();
      tile.points = tile.arrays = null;
    }
  }

  /** Calls `visit(x, y, z)` with every point that is held. */
  forEach(visit) {
    const { corner, side } = this.meta, unit = side / 65535;
    for (const { arrays: { steps } } of this.held)
      for (let k = 0; k < steps.length; k += 3)
        visit(corner[0] + unit * steps[k], corner[1] + unit * steps[k + 1], corner[2] + unit * steps[k + 2]);
  }
}
