// The camera of the 3-D view: it looks at a target from a distance, turned by yaw (0 looks forward) and pitch (a quarter
// turn looks straight down).

const LEAST_M = 0.5;
const MOST_M = 800;

/** Where a view looks from, radians; target and distance, metres, come from the points. */
export const VIEWS = {
  orbit: { yaw: -0.6, pitch: 0.55, field: 0.9 },
  above: { yaw: 0, pitch: Math.PI / 2, field: 0.9 },
  behind: { yaw: 0, pitch: 0.3, field: 0.9 },
  // As the sensor sees: turning looks around, zooming narrows the field.
  sensor: { yaw: 0, pitch: 0, field: 1.25, distance: 0 },
};
/** Share of the points that a view shows. */
const SHOWN = 0.98;
/** Share of the points whose middle it looks at: the rest lie far out. */
const INNER = 0.9;
/** What is near looks larger than what is far, so the target then moves to the middle of what is in sight, so often. */
const CENTRINGS = 3;
/** At most this many points are sampled to fit the camera. */
const SAMPLES = 4000;

export class Camera {
  constructor() {
    this.look("orbit");
  }

  /** Takes one of VIEWS. */
  look(name) {
    /** `aspect`: that of the view to which it fits the points, null before; `held`: a person moved it. */
    Object.assign(this, { distance: 34, target: [0, 0, 0], aspect: null, held: false }, VIEWS[name], { view: name });
  }

  /** Looks at the middle of points from where nearly all are in sight, in a view of this width to its height. */
  fit({ position, count }, aspect) {
    if (count === 0) return;
    this.aspect = aspect;
    if (this.distance === 0) return;
    const step = Math.ceil(count / SAMPLES);
    const some = Array.from({ length: Math.floor(count / step) }, (_, index) => [...position.subarray(3 * step * index, 3 * step * index + 3)]);
    const at = (values, part) => values.sort((one, other) => one - other)[Math.floor((values.length - 1) * part)];
    this.target = [0, 1, 2].map((axis) => {
      const values = some.map((point) => point[axis]);
      return (at(values, 1 - INNER) + at(values, INNER)) / 2;
    });
    const { right, up, into } = this.axes();
    const along = (axis, point) => axis.reduce((sum, value, index) => sum + value * (point[index] - this.target[index]), 0);
    const reach = Math.tan(this.field / 2);
    for (let turns = CENTRINGS; ; turns--) {
      const distances = some.map((point) =>
        Math.max(Math.abs(along(right, point)) / (reach * aspect), Math.abs(along(up, point)) / reach) - along(into, point));
      this.distance = Math.min(MOST_M, Math.max(LEAST_M, 1.1 * at(distances, SHOWN)));
      if (turns === 0) return;
      const seen = some.filter((point) => this.distance + along(into, point) > 0);
      for (const axis of [right, up]) {
        const slopes = seen.map((point) => along(axis, point) / (this.distance + along(into, point)));
        const middle = (at(slopes, 1 - SHOWN) + at(slopes, SHOWN)) / 2;
        this.target = this.target.map((value, index) => value + axis[index] * middle * this.distance);
      }
    }
  }

  /** Directions of the screen in space: right, up, and into it. */
  axes() {
    const [sinYaw, cosYaw, sin, cos] = [
      Math.sin(this.yaw), Math.cos(this.yaw), Math.sin(this.pitch), Math.cos(this.pitch),
    ];
    return {
      right: [cosYaw, -sinYaw, 0],
      up: [sinYaw * sin, cosYaw * sin, cos],
      into: [sinYaw * cos, cosYaw * cos, -sin],
    };
  }

  eye() {
    const { into } = this.axes();
    return this.target.map((value, axis) => value - into[axis] * this.distance);
  }

  turn(right, down) {
    this.held = true;
    // From the sensor, the scene follows the hand; else the camera goes around it.
    const sign = this.distance === 0 ? -1 : 1;
    this.yaw += sign * right;
    this.pitch = Math.min(Math.PI / 2, Math.max(this.distance === 0 ? -1.5 : -0.3, this.pitch + sign * down));
  }

  /** Moves by pixels of a view that is `height` pixels high. */
  pan(right, down, height) {
    this.held = true;
    if (this.distance === 0) return this.turn((right / height) * this.field, (down / height) * this.field);
    const { right: x, up: y } = this.axes();
    const metres = (2 * this.distance * Math.tan(this.field / 2)) / height;
    this.target = this.target.map((value, axis) => value + (-right * x[axis] + down * y[axis]) * metres);
  }

  /** Nearer (less than 1) or farther, by a factor. */
  zoom(factor) {
    this.held = true;
    if (this.distance === 0) this.field = Math.min(1.9, Math.max(0.05, this.field * factor));
    else this.distance = Math.min(MOST_M, Math.max(LEAST_M, this.distance * factor));
  }

  /** The matrix from space to clip space, column after column. */
  matrix(aspect) {
    const { right, up, into } = this.axes();
    const eye = this.eye();
    const dot = (axis) => axis[0] * eye[0] + axis[1] * eye[1] + axis[2] * eye[2];
    const scale = 1 / Math.tan(this.field / 2);
    const near = Math.max(0.1, this.distance * 0.01);
    const far = 2000;
    const [depth, offset] = [(far + near) / (far - near), (2 * far * near) / (far - near)];
    const matrix = new Float32Array(16);
    for (let axis = 0; axis < 3; axis++) {
      matrix[4 * axis] = (right[axis] * scale) / aspect;
      matrix[4 * axis + 1] = up[axis] * scale;
      matrix[4 * axis + 2] = into[axis] * depth;
      matrix[4 * axis + 3] = into[axis];
    }
    matrix[12] = (-dot(right) * scale) / aspect;
    matrix[13] = -dot(up) * scale;
    matrix[14] = -dot(into) * depth - offset;
    matrix[15] = -dot(into);
    return matrix;
  }
}

/** Where a point is in a view: x and y in pixels from the upper left, and its depth, not positive behind the eye. */
export function project(matrix, [x, y, z], { left, top, width, height }) {
  const depth = matrix[3] * x + matrix[7] * y + matrix[11] * z + matrix[15];
  const across = matrix[0] * x + matrix[4] * y + matrix[8] * z + matrix[12];
  const upward = matrix[1] * x + matrix[5] * y + matrix[9] * z + matrix[13];
  return [left + (1 + across / depth) * 0.5 * width, top + (1 - upward / depth) * 0.5 * height, depth];
}
