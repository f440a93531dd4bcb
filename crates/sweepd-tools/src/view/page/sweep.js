// A sweep's bytes, read as docs/layout.md defines them. Lengths are metres, angles radians, times nanoseconds; x is
// right of the sensor, y forward, z up.

// Written from the Rust types by SWEEPD_WRITE_PAGES=1 cargo test -p sweepd-sweep --test fields.
// begin fields: all
// What all sweeps have in common.
export const MAGIC = "sweepd\r\n";
export const LAYOUT_VERSION = 3;
export const ALIGN = 64;

// Labels of a pixel; segments count from the last one on.
export const LABEL_NONE = 0;
export const LABEL_GROUND = 1;
export const LABEL_FIRST_SEGMENT = 2;

// Properties of a sweep, as bits of flags.
export const PARTIAL = 1;
export const CIRCULAR = 2;
export const REVERSED = 4;
export const BLANKED = 8;
export const RATE_UNSTABLE = 16;
export const STOPPED = 32;
export const HEIGHT_ESTIMATED = 64;
export const LOSS_ESTIMATED = 128;
export const BLIND = 256;
export const COVERED = 512;
export const FROZEN = 1024;
export const FADED = 2048;
export const DARK_BELOW = 4096;
export const HEIGHT_IN_DOUBT = 8192;
export const NOT_SEEING = 0x1F00;

// Properties of a segment, as bits of flags.
export const SEGMENT_WIDE = 1;

// Which clock time_ns is in.
export const TIME_HOST = 0;
export const TIME_GPS = 1;

// Which of two returns is segmented.
export const CHOICE_NEAREST = 0;
export const CHOICE_STRONGEST = 1;
export const CHOICE_LAST = 2;

// The parts of a sweep behind its header.
export const PART_RANGE = 0;
export const PART_REFLECTIVITY = 1;
export const PART_LABEL = 2;
export const PART_RANGE2 = 3;
export const PART_REFLECTIVITY2 = 4;
export const PART_LABEL2 = 5;
export const PART_KIND = 6;
export const PART_COLUMNS = 7;
export const PART_BEAMS = 8;
export const PART_SEGMENTS = 9;

// Which of a pair of dual returns a plane holds.
export const KIND_STRONGEST = 1;
export const KIND_LAST = 2;
export const KIND_SECOND_BLOCKS = 4;

// The status: what a column holds.
export const COLUMN_MEASURED = 1;
export const COLUMN_MISSING = 2;
export const COLUMN_UNFIRED = 3;

// The return mode.
export const MODE_STRONGEST = 0x37;
export const MODE_LAST = 0x38;
export const MODE_DUAL = 0x39;

/** The structs of the layout: offset, type and name of each field, and the bytes of the whole. */
export const HEADER = {
  bytes: 448,
  fields: [
    [0, "u8[8]", "magic"],
    [8, "u32", "version"],
    [12, "u32", "header_bytes"],
    [16, "u64", "total_bytes"],
    [24, "u64[10]", "offsets"],
    [104, "u32", "rows"],
    [108, "u32", "columns"],
    [112, "u32", "columns_capacity"],
    [116, "u32", "segments"],
    [120, "u32", "segments_capacity"],
    [124, "u32", "model"],
    [128, "u32", "return_mode"],
    [132, "u32", "return_choice"],
    [136, "u32", "flags"],
    [140, "u32", "time_source"],
    [144, "u64", "sequence"],
    [152, "i64", "time_ns"],
    [160, "u64", "duration_ns"],
    [168, "i64", "sensor_time_ns"],
    [176, "i64", "arrival_ns"],
    [184, "f32", "rpm"],
    [188, "f32", "cut_azimuth_rad"],
    [192, "f32", "height_m"],
    [196, "f32", "pitch_rad"],
    [200, "f32", "roll_rad"],
    [204, "u32", "missing_columns"],
    [208, "u32", "lost_packets"],
    [212, "u32", "packets"],
    [216, "u32", "returns"],
    [220, "u32", "ground"],
    [224, "u32", "decode_ns"],
    [228, "u32", "ground_ns"],
    [232, "u32", "label_ns"],
    [236, "u32", "margin_columns"],
    [240, "u32", "unfired_columns"],
    [244, "u32", "dropped_datagrams"],
    [248, "f32", "yaw_rad"],
    [252, "u32", "height_doubt"],
    [256, "f32[3]", "position_m"],
    [272, "i64", "completed_ns"],
    [280, "i64", "completed_monotonic_ns"],
    [288, "i64", "run_ns"],
    [296, "u8[64]", "sensor"],
    [360, "u8[64]", "name"],
  ],
};

export const COLUMN = {
  bytes: 24,
  fields: [
    [0, "u64", "packet"],
    [8, "f32", "azimuth_rad"],
    [12, "f32", "azimuth_rate_rad_s"],
    [16, "u32", "time_ns"],
    [20, "u8", "block"],
    [21, "u8", "status"],
  ],
};

export const BEAM = {
  bytes: 48,
  fields: [
    [0, "u32", "channel"],
    [4, "f32", "elevation_rad"],
    [8, "f32", "rotation_rad"],
    [12, "u32", "time_offset_ns"],
    [16, "f32", "vertical_offset_m"],
    [20, "f32", "horizontal_offset_m"],
    [24, "i32", "shift"],
    [28, "f32", "distance_offset_m"],
    [32, "f32", "distance_offset_x_m"],
    [36, "f32", "distance_offset_y_m"],
  ],
};

export const SEGMENT = {
  bytes: 64,
  fields: [
    [0, "u32", "label"],
    [4, "u32", "points"],
    [8, "f32[3]", "min_m"],
    [20, "f32[3]", "max_m"],
    [32, "f32[3]", "centroid_m"],
    [44, "f32", "nearest_m"],
    [48, "u16", "row_first"],
    [50, "u16", "row_last"],
    [52, "u32", "column_first"],
    [56, "u32", "column_last"],
    [60, "u16", "flags"],
  ],
};

/** Models by their code. */
export const MODELS = [
  "unknown model", "VLP-16", "Puck LITE", "Puck Hi-Res", "HDL-32E", "HDL-64E S2", "HDL-64E S3", "VLP-32C", "VLS-128",
];
// end fields

// The two-point correction of an HDL-64E: from where on there is one offset, and where the others were measured.
const FAR_M = 25.04;
const NEAR_X_M = 2.40;
const NEAR_Y_M = 1.93;
const TURN = 2 * Math.PI;

/** Bytes that are not a sweep of this layout. */
export class LayoutError extends Error {}

const GETTERS = {
  u8: (view, at) => view.getUint8(at),
  u16: (view, at) => view.getUint16(at, true),
  u32: (view, at) => view.getUint32(at, true),
  i32: (view, at) => view.getInt32(at, true),
  f32: (view, at) => view.getFloat32(at, true),
  u64: (view, at) => view.getBigUint64(at, true),
  i64: (view, at) => view.getBigInt64(at, true),
};
const SIZES = { u8: 1, u16: 2, u32: 4, i32: 4, f32: 4, u64: 8, i64: 8 };

/** A struct at a place, as an object by the names of its fields; numbers of 64 bits are BigInt. */
function structAt(view, struct, at) {
  const found = {};
  for (const [offset, kind, name] of struct.fields) {
    const [, element, count] = /^(\w+?)(?:\[(\d+)\])?$/.exec(kind);
    const get = GETTERS[element];
    if (count === undefined) {
      found[name] = get(view, at + offset);
      continue;
    }
    found[name] = Array.from({ length: Number(count) }, (_, index) => get(view, at + offset + index * SIZES[element]));
  }
  return found;
}

function text(bytes) {
  const end = bytes.indexOf(0);
  return new TextDecoder().decode(new Uint8Array(end < 0 ? bytes : bytes.slice(0, end)));
}

/** The header, when everything in it can be true of these bytes: nothing that it tells lies outside of them. */
function checkedHeader(buffer) {
  if (buffer.byteLength < HEADER.bytes) throw new LayoutError(`${buffer.byteLength} bytes cannot hold a sweep`);
  const header = structAt(new DataView(buffer), HEADER, 0);
  if (String.fromCharCode(...header.magic) !== MAGIC) {
    throw new LayoutError("not a sweep of sweepd: the magic bytes at its beginning are missing");
  }
  if (header.version !== LAYOUT_VERSION) {
    throw new LayoutError(
      `a sweep of layout version ${header.version}, and this page reads version ${LAYOUT_VERSION}: load the page anew`);
  }
  const { rows, columns, columns_capacity: capacity, segments, segments_capacity: room, margin_columns: margin } = header;
  if (rows > 256 || capacity > 1 << 20 || room > 1 << 28 || margin + columns > capacity || segments > room) {
    throw new LayoutError("the header's counts contradict each other");
  }
  const pixels = rows * capacity;
  const other = header.offsets[PART_RANGE2] !== 0n ? pixels : 0;
  const sizes = [
    4 * pixels, pixels, 4 * pixels, 4 * other, other, 4 * other, other,
    COLUMN.bytes * capacity, BEAM.bytes * rows, SEGMENT.bytes * room,
  ];
  let end = HEADER.bytes;
  sizes.forEach((size, part) => {
    if (header.offsets[part] !== BigInt(size > 0 ? end : 0)) {
      throw new LayoutError("the header's offsets contradict its counts");
    }
    if (size > 0) end = Math.ceil((end + size) / ALIGN) * ALIGN;
  });
  if (header.total_bytes !== BigInt(end)) throw new LayoutError("the header's bytes contradict its counts");
  if (end > buffer.byteLength) throw new LayoutError(`${buffer.byteLength} bytes cannot hold a sweep of ${end}`);
  header.offsets = header.offsets.map(Number);
  header.sensor = text(header.sensor);
  header.name = text(header.name);
  return header;
}

/** A sweep: views of its bytes, trimmed to the columns and segments that there are. Index planes by
 *  `column * rows + row`; the planes of the other return are null in a sweep of one. */
export class Sweep {
  /** @param {ArrayBuffer} buffer the bytes; they must not change. Throws LayoutError. */
  constructor(buffer) {
    const header = checkedHeader(buffer);
    const { offsets, rows, columns: count, margin_columns: margin } = header;
    const view = new DataView(buffer);
    const plane = (part, Array) => {
      if (offsets[part] === 0) return part < PART_RANGE2 ? new Array(0) : null;
      return new Array(buffer, offsets[part] + margin * rows * Array.BYTES_PER_ELEMENT, count * rows);
    };
    this.buffer = buffer;
    this.header = header;
    this.rows = rows;
    this.count = count;
    this.range = plane(PART_RANGE, Float32Array);
    this.reflectivity = plane(PART_REFLECTIVITY, Uint8Array);
    this.label = plane(PART_LABEL, Uint32Array);
    this.range2 = plane(PART_RANGE2, Float32Array);
    this.reflectivity2 = plane(PART_REFLECTIVITY2, Uint8Array);
    this.label2 = plane(PART_LABEL2, Uint32Array);
    this.kind = plane(PART_KIND, Uint8Array);
    this.columns = new Columns(view, offsets[PART_COLUMNS] + margin * COLUMN.bytes, count);
    this.beams = Array.from({ length: rows }, (_, row) => structAt(view, BEAM, offsets[PART_BEAMS] + row * BEAM.bytes));
    this.segments = Array.from({ length: header.segments }, (_, entry) =>
      structAt(view, SEGMENT, offsets[PART_SEGMENTS] + entry * SEGMENT.bytes));
    this.rays = this.beams.map((beam) => new Ray(beam));
  }

  /** The pose of the sensor in a frame, "sensor" or "robot": three rows of four numbers; null in its own, where nothing
   *  moves. */
  pose(frame) {
    return frame === "robot" ? mountOf(this.header) : null;
  }

  /** Whether the header says how the sensor is mounted. */
  get isMounted() {
    const { position_m: at, yaw_rad: yaw, pitch_rad: pitch, roll_rad: roll } = this.header;
    return [...at, yaw, pitch, roll].some((value) => value !== 0);
  }

  /** Whether a bit of the flags is set. */
  has(flag) {
    return (this.header.flags & flag) !== 0;
  }

  /** The segment of a label; undefined for ground and for returns without label. */
  segment(label) {
    return label < LABEL_FIRST_SEGMENT ? undefined : this.segments[label - LABEL_FIRST_SEGMENT];
  }

  /** The column in which a pixel was fired. */
  firedIn(row, column) {
    const at = column + this.beams[row].shift;
    if (at >= 0 && at < this.count) return at;
    if (this.has(CIRCULAR)) return ((at % this.count) + this.count) % this.count;
    return at < 0 ? 0 : this.count - 1;
  }

  /** Azimuth of a pixel's beam when it fired, 0 to 2 pi, clockwise from +y. */
  azimuth(row, column) {
    const firing = this.firedIn(row, column);
    return wrapped(this.columns.azimuth[firing] + this.columns.rate[firing] * this.rays[row].delay - this.rays[row].rotation);
  }

  /** When a pixel's beam fired, nanoseconds after the sweep's first shot. */
  afterNs(row, column) {
    return this.columns.time[this.firedIn(row, column)] + this.beams[row].time_offset_ns;
  }

  /** Where a return of a pixel is: azimuth and elevation as seen from its beam's origin, and x, y, z. */
  place(row, column, range) {
    const azimuth = this.azimuth(row, column);
    const [sin, cos] = [Math.sin(azimuth), Math.cos(azimuth)];
    const ray = this.rays[row];
    const point = new Float64Array(3);
    ray.point(range, isNear(range), sin, cos, point, 0);
    if (!ray.bent) return { azimuth, elevation: this.beams[row].elevation_rad, point };
    const [x, y, z] = [point[0] + ray.sideways * cos, point[1] - ray.sideways * sin, point[2] - ray.up];
    return { azimuth: wrapped(Math.atan2(x, y)), elevation: Math.atan2(z, Math.hypot(x, y)), point };
  }

  /** One return of a pixel with all its properties: the segmented one or the other. Null where there is none. */
  at(row, column, other = false) {
    const pixel = column * this.rows + row;
    const range = (other ? this.range2 : this.range)?.[pixel];
    if (!(range > 0)) return null;
    const { azimuth, elevation, point } = this.place(row, column, range);
    return {
      row,
      column,
      other,
      range,
      azimuth,
      elevation,
      point,
      reflectivity: (other ? this.reflectivity2 : this.reflectivity)[pixel],
      label: (other ? this.label2 : this.label)[pixel],
      afterNs: this.afterNs(row, column),
      kind: this.kindAt(pixel, other),
    };
  }

  /** KIND_STRONGEST or KIND_LAST: what a return of a pixel is. */
  kindAt(pixel, other) {
    if (this.kind === null) return this.header.return_mode === MODE_LAST ? KIND_LAST : KIND_STRONGEST;
    const isLast = ((this.kind[pixel] & ~KIND_SECOND_BLOCKS) === KIND_LAST) !== other;
    return isLast ? KIND_LAST : KIND_STRONGEST;
  }

  /** Fills `points` with all returns, column after column, from the top row down; of a dual pixel the segmented one
   *  first. One pass, nothing allocated for a point. */
  fill(points, withOther = true) {
    const { rows, count, rays, range, label, label2, columns } = this;
    const range2 = withOther ? this.range2 : null;
    points.reserve(range.length * (range2 === null ? 1 : 2));
    const { position, labels, pixels } = points;
    const bits = bitsOf(range);
    const bits2 = range2 === null ? null : bitsOf(range2);
    const circular = this.has(CIRCULAR);
    let found = 0;
    for (let column = 0, pixel = 0; column < count; column++) {
      for (let row = 0; row < rows; row++, pixel++) {
        const first = range[pixel] > 0;
        const second = range2 !== null && range2[pixel] > 0;
        if (!first && !second) continue;
        const ray = rays[row];
        let firing = column + ray.columns;
        if (firing < 0 || firing >= count) {
          if (circular) firing = ((firing % count) + count) % count;
          else firing = firing < 0 ? 0 : count - 1;
        }
        const azimuth = columns.azimuth[firing] + columns.rate[firing] * ray.delay - ray.rotation;
        const sin = Math.sin(azimuth);
        const cos = Math.cos(azimuth);
        if (first) {
          ray.point(range[pixel], (bits[pixel] & 1) === 1, sin, cos, position, 3 * found);
          labels[found] = label[pixel];
          pixels[found++] = pixel;
        }
        if (second) {
          ray.point(range2[pixel], (bits2[pixel] & 1) === 1, sin, cos, position, 3 * found);
          labels[found] = label2[pixel];
          pixels[found++] = pixel | OTHER;
        }
      }
    }
    points.count = found;
  }
}

/** The sensor in the frame of the robot: it is rolled about its own y axis, pitched about x, turned about z, then moved. */
function mountOf({ position_m: [right, forward, up], yaw_rad: yaw, pitch_rad: pitch, roll_rad: roll }) {
  const [sr, cr, sp, cp] = [Math.sin(roll), Math.cos(roll), Math.sin(pitch), Math.cos(pitch)];
  const [sy, cy] = [Math.sin(yaw), Math.cos(yaw)];
  return [
    [cy * cr - sy * sp * sr, -sy * cp, cy * sr + sy * sp * cr, right],
    [sy * cr + cy * sp * sr, cy * cp, sy * sr - cy * sp * cr, forward],
    [-cp * sr, sp, cp * cr, up],
  ];
}

/** A point of the sensor in the frame of a pose. */
export function moved(pose, point) {
  if (pose === null) return point;
  const [x, y, z] = point;
  return pose.map(([a, b, c, d]) => a * x + b * y + c * z + d);
}

/** Whether the box of a segment says nothing of what is inside. */
export function isWide({ flags }) {
  return (flags & SEGMENT_WIDE) !== 0;
}

/** A segment in the frame of a pose: the box is that around its box. */
export function movedSegment(pose, segment) {
  if (pose === null) return segment;
  const end = (pick) => pose.map((row) =>
    [0, 1, 2].reduce((sum, axis) => sum + pick(row[axis] * segment.min_m[axis], row[axis] * segment.max_m[axis]), row[3]));
  return { ...segment, min_m: end(Math.min), max_m: end(Math.max), centroid_m: moved(pose, segment.centroid_m) };
}

/** A bit of an entry of `Points.pixels`: the return is the other one of its pixel. */
export const OTHER = 1 << 30;

/** Returns as columns of numbers, reused from sweep to sweep. */
export class Points {
  constructor() {
    this.count = 0;
    this.position = new Float32Array(0);
    this.labels = new Uint32Array(0);
    this.pixels = new Uint32Array(0);
  }

  /** Brings all points into the frame of a pose. */
  move(pose) {
    const { position } = this;
    const [[xx, xy, xz, right], [yx, yy, yz, forward], [zx, zy, zz, up]] = pose;
    for (let at = 0; at < 3 * this.count; at += 3) {
      const [x, y, z] = [position[at], position[at + 1], position[at + 2]];
      position[at] = xx * x + xy * y + xz * z + right;
      position[at + 1] = yx * x + yy * y + yz * z + forward;
      position[at + 2] = zx * x + zy * y + zz * z + up;
    }
  }

  /** Makes room for `count` points; what was there is lost where it was too little. */
  reserve(count) {
    if (this.labels.length >= count) return;
    this.position = new Float32Array(3 * count);
    this.labels = new Uint32Array(count);
    this.pixels = new Uint32Array(count);
  }
}

// Where the fields of a column are.
const AT = Object.fromEntries(COLUMN.fields.map(([offset, , name]) => [name, offset]));

/** The table of columns as arrays; `packets` is read when it is asked for. */
class Columns {
  constructor(view, start, count) {
    this.view = view;
    this.start = start;
    this.azimuth = new Float64Array(count);
    this.rate = new Float64Array(count);
    this.time = new Uint32Array(count);
    this.block = new Uint8Array(count);
    this.status = new Uint8Array(count);
    for (let column = 0; column < count; column++) {
      const at = start + column * COLUMN.bytes;
      this.azimuth[column] = view.getFloat32(at + AT.azimuth_rad, true);
      this.rate[column] = view.getFloat32(at + AT.azimuth_rate_rad_s, true);
      this.time[column] = view.getUint32(at + AT.time_ns, true);
      this.block[column] = view.getUint8(at + AT.block);
      this.status[column] = view.getUint8(at + AT.status);
    }
  }

  /** Ordinal of a column's data packet among the sensor's. */
  packet(column) {
    return this.view.getBigUint64(this.start + column * COLUMN.bytes + AT.packet, true);
  }
}

/** A beam's row, ready to give points. */
class Ray {
  constructor(beam) {
    this.columns = beam.shift;
    this.delay = beam.time_offset_ns * 1e-9;
    this.rotation = beam.rotation_rad;
    this.sideways = beam.horizontal_offset_m;
    this.up = beam.vertical_offset_m;
    this.sin = Math.sin(beam.elevation_rad);
    this.cos = Math.cos(beam.elevation_rad);
    // What the two-point correction loses each metre along x and y.
    this.slopeX = (beam.distance_offset_x_m - beam.distance_offset_m) / (FAR_M - NEAR_X_M);
    this.slopeY = (beam.distance_offset_y_m - beam.distance_offset_m) / (FAR_M - NEAR_Y_M);
    this.bent = this.slopeX !== 0 || this.slopeY !== 0;
  }

  /** Writes x, y, z of a range into `to[at..]`. `near`: the mark of the range says that the beam is bent there. */
  point(range, near, sin, cos, to, at) {
    const alongX = this.cos * sin;
    const alongY = this.cos * cos;
    let x = alongX * range;
    let y = alongY * range;
    let z = this.sin * range;
    if (near && this.bent) {
      // Each axis is a multiple of d and a constant; d is the one at which the length is the range.
      const ofX = 1 - this.slopeX * Math.abs(alongX);
      const ofY = 1 - this.slopeY * Math.abs(alongY);
      const baseX = this.slopeX * FAR_M;
      const baseY = this.slopeY * FAR_M;
      const [px, qx] = [ofX * alongX, baseX * alongX];
      const [py, qy] = [ofY * alongY, baseY * alongY];
      const [pz, qz] = [((ofX + ofY) / 2) * this.sin, ((baseX + baseY) / 2) * this.sin];
      const square = px * px + py * py + pz * pz;
      const linear = px * qx + py * qy + pz * qz;
      const root = linear * linear - square * (qx * qx + qy * qy + qz * qz - range * range);
      if (root >= 0 && square > 0) {
        const d = (Math.sqrt(root) - linear) / square;
        x = px * d + qx;
        y = py * d + qy;
        z = pz * d + qz;
      }
    }
    to[at] = x - this.sideways * cos;
    to[at + 1] = y + this.sideways * sin;
    to[at + 2] = z + this.up;
  }
}

function bitsOf(plane) {
  return new Uint32Array(plane.buffer, plane.byteOffset, plane.length);
}

/** Whether the mark of a range, its last bit, says that a bent beam's correction applies. */
function isNear(range) {
  return (new Uint32Array(Float32Array.of(range).buffer)[0] & 1) === 1;
}

/** An angle in 0 to 2 pi. */
function wrapped(angle) {
  const turned = angle - TURN * Math.floor(angle / TURN);
  return turned < TURN ? turned : 0;
}
