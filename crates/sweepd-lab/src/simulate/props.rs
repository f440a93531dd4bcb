//! What stands and moves in the scenes, each made of a few solids.
//!
//! Sizes are those of the real things, in metres; numbers like 220 are reflectivities (see
//! [`Surface`]).

use super::scene::Surface::{self, Leaves, Plain, Windows};
use super::shape::Shape;

/// The solids of one object.
pub type Parts = Vec<(Shape, Surface)>;

/// Where a thing stands and which way it faces.
#[derive(Clone, Copy, Debug)]
pub struct GroundPose {
    /// To the right, metres.
    pub x: f64,
    /// Ahead, metres.
    pub y: f64,
    /// Above the road, metres.
    pub z: f64,
    /// Clockwise from ahead, radians.
    pub heading_rad: f64,
}

impl GroundPose {
    /// A place on the road.
    pub fn new(x: f64, y: f64, heading_rad: f64) -> Self {
        Self {
            x,
            y,
            z: 0.0,
            heading_rad,
        }
    }

    /// The same, this much higher.
    pub fn raised(self, z: f64) -> Self {
        Self {
            z: self.z + z,
            ..self
        }
    }

    /// A point to the right of, ahead of and above the place, as it faces.
    fn at(&self, across: f64, along: f64, up: f64) -> [f64; 3] {
        let (sin, cos) = self.heading_rad.sin_cos();
        [
            self.x + across * cos + along * sin,
            self.y - across * sin + along * cos,
            self.z + up,
        ]
    }

    /// A cuboid in the frame of the place: width across, length along, height.
    pub fn cuboid(&self, [across, along, up]: [f64; 3], size: [f64; 3]) -> Shape {
        Shape::cuboid(self.at(across, along, up), size, self.heading_rad)
    }

    /// An upright cylinder in the frame of the place.
    pub fn cylinder(&self, [across, along, up]: [f64; 3], radius_m: f64, height_m: f64) -> Shape {
        Shape::cylinder(self.at(across, along, up), radius_m, height_m)
    }

    fn ball(&self, [across, along, up]: [f64; 3], semi: [f64; 3]) -> Shape {
        Shape::ellipsoid(self.at(across, along, up), semi)
    }
}

const TYRE: Surface = Plain(6);
const PLATE: Surface = Plain(220);

fn wheels(
    place: &GroundPose,
    across: f64,
    along: f64,
    size: [f64; 3],
) -> impl Iterator<Item = (Shape, Surface)> {
    [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]
        .map(|(side, end)| (place.cuboid([side * across, end * along, 0.0], size), TYRE))
        .into_iter()
}

fn plates(place: &GroundPose, along: f64) -> [(Shape, Surface); 2] {
    [-1.0, 1.0].map(|end| {
        (
            place.cuboid([0.0, end * along, 0.45], [0.52, 0.02, 0.11]),
            PLATE,
        )
    })
}

/// A passenger car: body, glass and roof in two steps, wheels with the gap between them, number
/// plates.
pub fn car(place: GroundPose, length_m: f64, paint: u8) -> Parts {
    let body = [1.78, length_m, 0.56];
    let mut parts = vec![
        (place.cuboid([0.0, 0.0, 0.27], body), Plain(paint)),
        (
            place.cuboid([0.0, -0.25, 0.83], [1.62, 0.60 * length_m, 0.30]),
            Plain(9),
        ),
        (
            place.cuboid([0.0, -0.30, 1.13], [1.42, 0.44 * length_m, 0.32]),
            Plain(paint),
        ),
    ];
    parts.extend(wheels(&place, 0.80, 0.31 * length_m, [0.2, 0.62, 0.62]));
    parts.extend(plates(&place, 0.5 * length_m + 0.01));
    parts
}

/// A delivery van.
pub fn van(place: GroundPose, paint: u8) -> Parts {
    let mut parts = vec![
        (
            place.cuboid([0.0, -0.4, 0.40], [1.95, 4.6, 2.0]),
            Plain(paint),
        ),
        (
            place.cuboid([0.0, 2.3, 0.40], [1.85, 0.9, 0.75]),
            Plain(paint),
        ),
    ];
    parts.extend(wheels(&place, 0.86, 1.7, [0.22, 0.68, 0.68]));
    parts.extend(plates(&place, 2.76));
    parts
}

/// A lorry with a box body.
pub fn lorry(place: GroundPose, paint: u8) -> Parts {
    let mut parts = vec![
        (
            place.cuboid([0.0, -1.2, 1.0], [2.5, 6.6, 2.5]),
            Plain(paint),
        ),
        (place.cuboid([0.0, 3.3, 0.5], [2.4, 1.9, 2.3]), Plain(30)),
        (place.cuboid([0.0, -4.52, 0.7], [2.2, 0.03, 0.14]), PLATE),
    ];
    parts.extend(wheels(&place, 1.05, 2.9, [0.3, 1.0, 1.0]));
    parts
}

/// Someone on foot, in mid-stride.
pub fn person(place: GroundPose, height_m: f64, clothes: u8) -> Parts {
    let s = height_m / 1.75;
    let limb = |across, along, up, radius_m, length_m| {
        (
            place.cylinder([across * s, along * s, up * s], radius_m * s, length_m * s),
            Plain(clothes),
        )
    };
    vec![
        limb(-0.10, 0.16, 0.0, 0.08, 0.84),
        limb(0.10, -0.16, 0.0, 0.08, 0.84),
        limb(-0.26, -0.06, 0.75, 0.05, 0.65),
        limb(0.26, 0.06, 0.75, 0.05, 0.65),
        (
            place.ball([0.0, 0.0, 1.13 * s], [0.21 * s, 0.21 * s, 0.37 * s]),
            Plain(clothes),
        ),
        (
            place.ball([0.0, 0.0, 1.62 * s], [0.11 * s, 0.11 * s, 0.13 * s]),
            Plain(35),
        ),
    ]
}

/// Someone on a bicycle, with a reflector at the back.
pub fn cyclist(place: GroundPose, clothes: u8) -> Parts {
    vec![
        (place.cuboid([0.0, -0.52, 0.0], [0.05, 0.66, 0.66]), TYRE),
        (place.cuboid([0.0, 0.52, 0.0], [0.05, 0.66, 0.66]), TYRE),
        (place.cuboid([0.0, 0.0, 0.50], [0.05, 1.0, 0.14]), Plain(25)),
        (
            place.cuboid([0.0, 0.45, 1.0], [0.55, 0.05, 0.05]),
            Plain(15),
        ),
        (
            place.cylinder([-0.11, 0.05, 0.30], 0.08, 0.65),
            Plain(clothes),
        ),
        (
            place.cylinder([0.11, -0.05, 0.40], 0.08, 0.60),
            Plain(clothes),
        ),
        (
            place.ball([0.0, 0.05, 1.25], [0.21, 0.22, 0.37]),
            Plain(clothes),
        ),
        (place.ball([0.0, 0.15, 1.72], [0.12, 0.12, 0.14]), Plain(45)),
        (place.cuboid([0.0, -0.86, 0.7], [0.08, 0.02, 0.08]), PLATE),
    ]
}

/// A lamp post; its arm points the way it faces.
pub fn lamp(place: GroundPose) -> Parts {
    vec![
        (place.cylinder([0.0, 0.0, 0.0], 0.11, 1.2), Plain(40)),
        (place.cylinder([0.0, 0.0, 1.2], 0.075, 4.8), Plain(40)),
        (place.cuboid([0.0, 0.8, 5.85], [0.25, 1.7, 0.12]), Plain(40)),
    ]
}

/// A traffic sign on its post; the plate faces the way it faces.
pub fn sign(place: GroundPose) -> Parts {
    vec![
        (place.cylinder([0.0, 0.0, 0.0], 0.035, 2.1), Plain(45)),
        (
            place.cuboid([0.0, 0.05, 1.9], [0.62, 0.02, 0.62]),
            Plain(235),
        ),
    ]
}

/// A bollard with a reflecting band.
pub fn bollard(place: GroundPose) -> Parts {
    vec![
        (place.cylinder([0.0, 0.0, 0.0], 0.06, 0.95), Plain(12)),
        (place.cylinder([0.0, 0.0, 0.75], 0.063, 0.1), Plain(180)),
    ]
}

/// A tree: trunk and two overlapping masses of leaves. A size of 1 is about 6 m high.
pub fn tree(place: GroundPose, size: f64) -> Parts {
    let leaves = Leaves {
        reflectivity: 32,
        free_path_m: 0.9,
    };
    let [wide, high] = [1.7 * size, 1.5 * size];
    vec![
        (
            place.cylinder([0.0, 0.0, 0.0], 0.13 * size, 3.2 * size),
            Plain(22),
        ),
        (
            place.ball([0.2, 0.1, 3.9 * size], [wide, wide, high]),
            leaves,
        ),
        (
            place.ball(
                [-0.4, -0.3, 4.8 * size],
                [0.7 * wide, 0.7 * wide, 0.8 * high],
            ),
            leaves,
        ),
    ]
}

/// A hedge along the way it faces.
pub fn hedge(place: GroundPose, length_m: f64) -> Parts {
    vec![(
        place.cuboid([0.0; 3], [0.7, length_m, 1.1]),
        Leaves {
            reflectivity: 30,
            free_path_m: 0.1,
        },
    )]
}

/// A litter bin.
pub fn bin(place: GroundPose) -> Parts {
    vec![(place.cylinder([0.0; 3], 0.24, 0.95), Plain(18))]
}

/// A bench, its back to its left.
pub fn bench(place: GroundPose) -> Parts {
    vec![
        (place.cuboid([0.0, 0.0, 0.40], [0.45, 1.8, 0.06]), Plain(28)),
        (
            place.cuboid([-0.25, 0.0, 0.45], [0.06, 1.8, 0.42]),
            Plain(28),
        ),
        (
            place.cuboid([0.0, -0.75, 0.0], [0.4, 0.08, 0.40]),
            Plain(14),
        ),
        (place.cuboid([0.0, 0.75, 0.0], [0.4, 0.08, 0.40]), Plain(14)),
    ]
}

/// A bus shelter, its back to its left.
pub fn shelter(place: GroundPose) -> Parts {
    vec![
        (place.cuboid([-0.6, 0.0, 0.1], [0.04, 3.6, 2.1]), Plain(7)),
        (place.cuboid([-0.2, -1.8, 0.1], [0.8, 0.04, 2.1]), Plain(7)),
        (place.cuboid([0.0, 0.0, 2.3], [1.5, 3.8, 0.12]), Plain(35)),
        (place.cylinder([0.55, 1.7, 0.0], 0.05, 2.3), Plain(40)),
        (place.cylinder([0.55, -1.7, 0.0], 0.05, 2.3), Plain(40)),
    ]
}

/// Length, depth and height of a house; its front faces the way it faces, on its place.
#[derive(Clone, Copy, Debug)]
pub struct House {
    /// Along the street.
    pub width_m: f64,
    /// Away from it.
    pub depth_m: f64,
    /// To the eaves.
    pub height_m: f64,
    /// Reflectivity of the plaster.
    pub plaster: u8,
    /// A gateway through to the yard.
    pub gateway: bool,
    /// Bay windows or balconies on the upper floors.
    pub bays: bool,
}

/// A house: walls with windows, a doorstep, and a gateway or bays where it has them.
pub fn house(place: GroundPose, house: House) -> Parts {
    let House {
        width_m,
        depth_m,
        height_m,
        plaster,
        gateway,
        bays,
    } = house;
    let wall = Windows(plaster);
    let body = |from: f64, to: f64, up: f64, height_m: f64| {
        (
            place.cuboid(
                [(from + to) / 2.0, -depth_m / 2.0, up],
                [to - from, depth_m, height_m],
            ),
            wall,
        )
    };
    let (left, right) = (-width_m / 2.0, width_m / 2.0);
    let mut parts = if gateway {
        vec![
            body(left, -1.5, 0.0, 3.4),
            body(1.5, right, 0.0, 3.4),
            body(left, right, 3.4, height_m - 3.4),
        ]
    } else {
        vec![body(left, right, 0.0, height_m)]
    };
    let door = place.cuboid([0.3 * width_m, 0.2, 0.0], [1.6, 0.5, 0.3]);
    parts.push((door, Plain(30)));
    if bays {
        for across in [-0.25, 0.25].map(|part| part * width_m) {
            parts.push((
                place.cuboid([across, 0.4, 3.2], [2.4, 1.0, height_m - 4.5]),
                wall,
            ));
        }
    }
    parts
}
