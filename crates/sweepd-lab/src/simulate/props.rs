//! Props of the scenes, each made of a few solids.
//!
//! Sizes are those of the real things, in metres; numbers like 220 are reflectivities (see
//! [`Surface`]).

use super::scene::Class;
use super::scene::Surface::{self, Leaves, Plain, Windows};
use super::shape::Shape;

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
    fn at(&self, offset: [f64; 3]) -> [f64; 3] {
        let [across, along, up] = offset;
        let (sin, cos) = self.heading_rad.sin_cos();
        [
            self.x + across * cos + along * sin,
            self.y - across * sin + along * cos,
            self.z + up,
        ]
    }
}

/// A thing that stands somewhere: its solids are given in the frame of its place.
#[derive(Clone, Debug)]
pub struct Prop {
    /// What it is.
    pub class: Class,
    /// Where it stands.
    pub place: GroundPose,
    /// Its solids, in the frame of the scene.
    pub solids: Vec<(Shape, Surface)>,
}

impl Prop {
    /// A thing without solids.
    pub fn new(class: Class, place: GroundPose) -> Self {
        Self {
            class,
            place,
            solids: Vec::new(),
        }
    }

    /// Adds a cuboid on the centre of its base: width across, length along, height.
    pub fn cuboid(mut self, base: [f64; 3], size: [f64; 3], surface: Surface) -> Self {
        let shape = Shape::cuboid(self.place.at(base), size, self.place.heading_rad);
        self.solids.push((shape, surface));
        self
    }

    /// Adds an upright cylinder on the centre of its foot.
    pub fn cylinder(
        mut self,
        foot: [f64; 3],
        radius_m: f64,
        height_m: f64,
        surface: Surface,
    ) -> Self {
        let shape = Shape::cylinder(self.place.at(foot), radius_m, height_m);
        self.solids.push((shape, surface));
        self
    }

    /// Adds an ellipsoid about its centre.
    fn ellipsoid(mut self, centre: [f64; 3], semi: [f64; 3], surface: Surface) -> Self {
        let shape = Shape::ellipsoid(self.place.at(centre), semi);
        self.solids.push((shape, surface));
        self
    }

    fn wheels(mut self, across: f64, along: f64, size: [f64; 3]) -> Self {
        for (side, end) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
            self = self.cuboid([side * across, end * along, 0.0], size, TYRE);
        }
        self
    }

    fn plates(self, along: f64) -> Self {
        let size = [0.52, 0.02, 0.11];
        self.cuboid([0.0, -along, 0.45], size, PLATE)
            .cuboid([0.0, along, 0.45], size, PLATE)
    }
}

const TYRE: Surface = Plain(6);
const PLATE: Surface = Plain(220);

/// A passenger car: body, glass and roof in two steps, wheels with the gap between them, number
/// plates.
pub fn car(place: GroundPose, length_m: f64, paint: u8) -> Prop {
    Prop::new(Class::Car, place)
        .cuboid([0.0, 0.0, 0.27], [1.78, length_m, 0.56], Plain(paint))
        .cuboid([0.0, -0.25, 0.83], [1.62, 0.60 * length_m, 0.30], Plain(9))
        .cuboid(
            [0.0, -0.30, 1.13],
            [1.42, 0.44 * length_m, 0.32],
            Plain(paint),
        )
        .wheels(0.80, 0.31 * length_m, [0.2, 0.62, 0.62])
        .plates(0.5 * length_m + 0.01)
}

/// A delivery van.
pub fn van(place: GroundPose, paint: u8) -> Prop {
    Prop::new(Class::Lorry, place)
        .cuboid([0.0, -0.4, 0.40], [1.95, 4.6, 2.0], Plain(paint))
        .cuboid([0.0, 2.3, 0.40], [1.85, 0.9, 0.75], Plain(paint))
        .wheels(0.86, 1.7, [0.22, 0.68, 0.68])
        .plates(2.76)
}

/// A lorry with a box body.
pub fn lorry(place: GroundPose, paint: u8) -> Prop {
    Prop::new(Class::Lorry, place)
        .cuboid([0.0, -1.2, 1.0], [2.5, 6.6, 2.5], Plain(paint))
        .cuboid([0.0, 3.3, 0.5], [2.4, 1.9, 2.3], Plain(30))
        .cuboid([0.0, -4.52, 0.7], [2.2, 0.03, 0.14], PLATE)
        .wheels(1.05, 2.9, [0.3, 1.0, 1.0])
}

/// Someone on foot, in mid-stride.
pub fn person(place: GroundPose, height_m: f64, clothes: u8) -> Prop {
    let s = height_m / 1.75;
    let mut person = Prop::new(Class::Person, place);
    for ([across, along, up], radius_m, length_m) in [
        ([-0.10, 0.16, 0.0], 0.08, 0.84),
        ([0.10, -0.16, 0.0], 0.08, 0.84),
        ([-0.26, -0.06, 0.75], 0.05, 0.65),
        ([0.26, 0.06, 0.75], 0.05, 0.65),
    ] {
        let foot = [across * s, along * s, up * s];
        person = person.cylinder(foot, radius_m * s, length_m * s, Plain(clothes));
    }
    person
        .ellipsoid(
            [0.0, 0.0, 1.13 * s],
            [0.21 * s, 0.21 * s, 0.37 * s],
            Plain(clothes),
        )
        .ellipsoid(
            [0.0, 0.0, 1.62 * s],
            [0.11 * s, 0.11 * s, 0.13 * s],
            Plain(35),
        )
}

/// Someone on a bicycle, with a reflector at the back.
pub fn cyclist(place: GroundPose, clothes: u8) -> Prop {
    Prop::new(Class::Cyclist, place)
        .cuboid([0.0, -0.52, 0.0], [0.05, 0.66, 0.66], TYRE)
        .cuboid([0.0, 0.52, 0.0], [0.05, 0.66, 0.66], TYRE)
        .cuboid([0.0, 0.0, 0.50], [0.05, 1.0, 0.14], Plain(25))
        .cuboid([0.0, 0.45, 1.0], [0.55, 0.05, 0.05], Plain(15))
        .cylinder([-0.11, 0.05, 0.30], 0.08, 0.65, Plain(clothes))
        .cylinder([0.11, -0.05, 0.40], 0.08, 0.60, Plain(clothes))
        .ellipsoid([0.0, 0.05, 1.25], [0.21, 0.22, 0.37], Plain(clothes))
        .ellipsoid([0.0, 0.15, 1.72], [0.12, 0.12, 0.14], Plain(45))
        .cuboid([0.0, -0.86, 0.7], [0.08, 0.02, 0.08], PLATE)
}

/// A lamp post; its arm points the way it faces.
pub fn lamp(place: GroundPose) -> Prop {
    Prop::new(Class::Pole, place)
        .cylinder([0.0, 0.0, 0.0], 0.11, 1.2, Plain(40))
        .cylinder([0.0, 0.0, 1.2], 0.075, 4.8, Plain(40))
        .cuboid([0.0, 0.8, 5.85], [0.25, 1.7, 0.12], Plain(40))
}

/// A traffic sign on its post; the plate faces the way it faces.
pub fn sign(place: GroundPose) -> Prop {
    Prop::new(Class::Sign, place)
        .cylinder([0.0, 0.0, 0.0], 0.035, 2.1, Plain(45))
        .cuboid([0.0, 0.05, 1.9], [0.62, 0.02, 0.62], Plain(235))
}

/// A bollard with a reflecting band.
pub fn bollard(place: GroundPose) -> Prop {
    Prop::new(Class::Pole, place)
        .cylinder([0.0, 0.0, 0.0], 0.06, 0.95, Plain(12))
        .cylinder([0.0, 0.0, 0.75], 0.063, 0.1, Plain(180))
}

/// A tree: trunk and two overlapping masses of leaves. A size of 1 is about 6 m high.
pub fn tree(place: GroundPose, size: f64) -> Prop {
    let leaves = Leaves {
        reflectivity: 32,
        free_path_m: 0.9,
    };
    let wide = 1.7 * size;
    let high = 1.5 * size;
    let top = [0.7 * wide, 0.7 * wide, 0.8 * high];
    Prop::new(Class::Tree, place)
        .cylinder([0.0, 0.0, 0.0], 0.13 * size, 3.2 * size, Plain(22))
        .ellipsoid([0.2, 0.1, 3.9 * size], [wide, wide, high], leaves)
        .ellipsoid([-0.4, -0.3, 4.8 * size], top, leaves)
}

/// A hedge along the way it faces.
pub fn hedge(place: GroundPose, length_m: f64) -> Prop {
    let leaves = Leaves {
        reflectivity: 30,
        free_path_m: 0.1,
    };
    Prop::new(Class::Tree, place).cuboid([0.0; 3], [0.7, length_m, 1.1], leaves)
}

/// A litter bin.
pub fn bin(place: GroundPose) -> Prop {
    Prop::new(Class::Furniture, place).cylinder([0.0; 3], 0.24, 0.95, Plain(18))
}

/// A bench, its back to its left.
pub fn bench(place: GroundPose) -> Prop {
    Prop::new(Class::Furniture, place)
        .cuboid([0.0, 0.0, 0.40], [0.45, 1.8, 0.06], Plain(28))
        .cuboid([-0.25, 0.0, 0.45], [0.06, 1.8, 0.42], Plain(28))
        .cuboid([0.0, -0.75, 0.0], [0.4, 0.08, 0.40], Plain(14))
        .cuboid([0.0, 0.75, 0.0], [0.4, 0.08, 0.40], Plain(14))
}

/// A bus shelter, its back to its left.
pub fn shelter(place: GroundPose) -> Prop {
    Prop::new(Class::Furniture, place)
        .cuboid([-0.6, 0.0, 0.1], [0.04, 3.6, 2.1], Plain(7))
        .cuboid([-0.2, -1.8, 0.1], [0.8, 0.04, 2.1], Plain(7))
        .cuboid([0.0, 0.0, 2.3], [1.5, 3.8, 0.12], Plain(35))
        .cylinder([0.55, 1.7, 0.0], 0.05, 2.3, Plain(40))
        .cylinder([0.55, -1.7, 0.0], 0.05, 2.3, Plain(40))
}

/// A box on the floor: width across, length along, height.
pub fn carton(place: GroundPose, size: [f64; 3], paper: u8) -> Prop {
    Prop::new(Class::Furniture, place).cuboid([0.0; 3], size, Plain(paper))
}

/// Length, width and height of a EUR pallet (EN 13698-1).
const PALLET_M: [f64; 3] = [1.2, 0.8, PALLET_HIGH_M];
/// Its height alone, metres.
pub const PALLET_HIGH_M: f64 = 0.144;

/// A EUR pallet, its length along the way it faces: a deck on nine blocks, which stand on three
/// boards. Goods of this height lie on it, metres; 0 for none.
pub fn pallet(place: GroundPose, goods_m: f64, paper: u8) -> Prop {
    let [length_m, width_m, height_m] = PALLET_M;
    let (board_m, block_m) = (0.022, 0.078);
    let wood = Plain(42);
    let deck_m = board_m + block_m;
    let mut pallet = Prop::new(Class::Pallet, place).cuboid(
        [0.0, 0.0, deck_m],
        [width_m, length_m, height_m - deck_m],
        wood,
    );
    for across in [-0.35, 0.0, 0.35] {
        pallet = pallet.cuboid([across, 0.0, 0.0], [0.1, length_m, board_m], wood);
        for along in [-0.5275, 0.0, 0.5275] {
            let base = [across, along, board_m];
            pallet = pallet.cuboid(base, [0.1, 0.145, block_m], wood);
        }
    }
    if goods_m == 0.0 {
        return pallet;
    }
    let size = [width_m - 0.04, length_m - 0.04, goods_m];
    pallet.cuboid([0.0, 0.0, height_m], size, Plain(paper))
}

/// Empty pallets on each other.
pub fn pallet_stack(place: GroundPose, count: u32) -> Prop {
    let mut stack = Prop::new(Class::Pallet, place);
    for number in 0..count {
        let one = pallet(place.raised(f64::from(number) * PALLET_HIGH_M), 0.0, 0);
        stack.solids.extend(one.solids);
    }
    stack
}

/// From post to post of a rack along it, metres: three pallets side by side.
pub const BAY_M: f64 = 2.8;
/// Heights of the beams of a rack above the floor, metres.
pub const BEAMS_M: [f64; 2] = [1.6, 3.2];

/// A pallet rack of some bays along the way it faces: thin posts, and beams on which pallets lie.
pub fn rack(place: GroundPose, bays: u32) -> Prop {
    let mut rack = Prop::new(Class::Furniture, place);
    let half_m = f64::from(bays) * BAY_M / 2.0;
    for across in [-0.5, 0.5] {
        for post in 0..=bays {
            let base = [across, f64::from(post) * BAY_M - half_m, 0.0];
            rack = rack.cuboid(base, [0.07, 0.09, 4.4], Plain(28));
        }
        for up in BEAMS_M {
            let base = [across, 0.0, up - 0.12];
            rack = rack.cuboid(base, [0.05, 2.0 * half_m, 0.12], Plain(50));
        }
    }
    rack
}

/// A forklift: body, guard over the driver, mast, and forks in front.
pub fn forklift(place: GroundPose) -> Prop {
    let mut forklift = Prop::new(Class::Lorry, place)
        .cuboid([0.0, -0.3, 0.2], [1.1, 1.7, 0.8], Plain(55))
        .cuboid([0.0, -0.3, 2.05], [1.0, 1.2, 0.06], Plain(12))
        .wheels(0.5, 0.55, [0.2, 0.5, 0.5]);
    for across in [-0.45, 0.45] {
        for along in [-0.85, 0.25] {
            forklift = forklift.cuboid([across, along, 1.0], [0.06, 0.06, 1.05], Plain(12));
        }
        let fork = [0.5 * across, 1.25, 0.1];
        forklift = forklift
            .cuboid([0.8 * across, 0.65, 0.1], [0.1, 0.15, 2.1], Plain(15))
            .cuboid(fork, [0.12, 1.1, 0.04], Plain(15));
    }
    forklift
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

impl House {
    /// Adds a stretch of its walls, from one place along its front to another.
    fn add_body(&self, prop: Prop, along: [f64; 2], up: f64, height_m: f64) -> Prop {
        let [from, to] = along;
        prop.cuboid(
            [(from + to) / 2.0, -self.depth_m / 2.0, up],
            [to - from, self.depth_m, height_m],
            Windows(self.plaster),
        )
    }
}

/// A house: walls with windows, a doorstep, and a gateway or bays where it has them.
pub fn house(place: GroundPose, house: House) -> Prop {
    let left = -house.width_m / 2.0;
    let right = house.width_m / 2.0;
    let mut prop = Prop::new(Class::Building, place);
    if house.gateway {
        prop = house.add_body(prop, [left, -1.5], 0.0, 3.4);
        prop = house.add_body(prop, [1.5, right], 0.0, 3.4);
        prop = house.add_body(prop, [left, right], 3.4, house.height_m - 3.4);
    } else {
        prop = house.add_body(prop, [left, right], 0.0, house.height_m);
    }
    let doorstep = [0.3 * house.width_m, 0.2, 0.0];
    prop = prop.cuboid(doorstep, [1.6, 0.5, 0.3], Plain(30));
    if house.bays {
        for part in [-0.25, 0.25] {
            let base = [part * house.width_m, 0.4, 3.2];
            let size = [2.4, 1.0, house.height_m - 4.5];
            prop = prop.cuboid(base, size, Windows(house.plaster));
        }
    }
    prop
}
