// What is selected: one frame or one edge, and who is told.
export class Selection {
  constructor() {
    this.frame = null;
    this.edge = null;
    this.followers = [];
  }

  set(frame, edge) {
    Object.assign(this, { frame, edge });
    for (const follow of this.followers) follow(this);
  }
}
