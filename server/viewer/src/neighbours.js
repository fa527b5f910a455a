// A hash of points by cell, to find what lies near.

export class NeighbourGrid {
  /**
   * @param {Float32Array} position three numbers a point
   * @param {number} edge of the grid's cells, in the same units
   */
  constructor(position, edge) {
    this.position = position;
    this.edge = edge;
    const count = position.length / 3;
    this.mask = 2 ** Math.ceil(Math.log2(Math.max(2, count))) - 1;
    this.starts = new Uint32Array(this.mask + 2);
    this.points = new Uint32Array(count);
    this.#fill(count);
  }

  /** Counts the points of each bucket, adds up, then puts each point in its place. */
  #fill(count) {
    const buckets = new Uint32Array(count);
    for (let i = 0; i < count; ++i) {
      buckets[i] = this.#bucket(...this.#cell(i, 0));
      ++this.starts[buckets[i] + 1];
    }
    for (let b = 1; b < this.starts.length; ++b) this.starts[b] += this.starts[b - 1];
    const next = this.starts.slice();
    for (let i = 0; i < count; ++i) this.points[next[buckets[i]]++] = i;
  }

  #bucket(x, y, z) {
    const hash = Math.imul(x, 73856093) ^ Math.imul(y, 19349663) ^ Math.imul(z, 83492791);
    return (hash ^ (hash >>> 15)) & this.mask;
  }

  /** The cell of point i, moved by `shift` along each axis. */
  #cell(i, shift) {
    const p = this.position, e = this.edge;
    return [
      Math.floor((p[3 * i] + shift) / e), Math.floor((p[3 * i + 1] + shift) / e),
      Math.floor((p[3 * i + 2] + shift) / e)
    ];
  }

  distance2(i, j) {
    const p = this.position;
    return (p[3 * i] - p[3 * j]) ** 2 + (p[3 * i + 1] - p[3 * j + 1]) ** 2 +
        (p[3 * i + 2] - p[3 * j + 2]) ** 2;
  }

  /**
   * Calls `visit(j, squared distance)` for each other point within `reach` of point i, once, until
   * it returns false.
   */
  visit(i, reach, visit) {
    const low = this.#cell(i, -reach), high = this.#cell(i, reach), reach2 = reach * reach;
    const seen = new Set();  // Two cells may share a bucket.
    for (let x = low[0]; x <= high[0]; ++x) {
      for (let y = low[1]; y <= high[1]; ++y) {
        for (let z = low[2]; z <= high[2]; ++z) seen.add(this.#bucket(x, y, z));
      }
    }
    for (const bucket of seen) {
      for (let k = this.starts[bucket]; k < this.starts[bucket + 1]; ++k) {
        const j = this.points[k];
        const d2 = j === i ? Infinity : this.distance2(i, j);
        if (d2 <= reach2 && visit(j, d2) === false) return;
      }
    }
  }

  /** The distance to the nearest other point, up to `farthest`; infinite beyond. */
  nearest(i, farthest) {
    for (let reach = this.edge;; reach = Math.min(2 * reach, farthest)) {
      let best = Infinity;
      this.visit(i, reach, (_, d2) => {
        best = Math.min(best, d2);
      });
      if (best < Infinity || reach >= farthest) return Math.sqrt(best);
    }
  }
}
