//! Things that a robot meets, ahead of it.

use std::f64::consts::FRAC_PI_2;

use super::{Ground, Scene, Solid};

/// How high a kerb is, metres.
const KERB_M: f64 = 0.12;
/// How long a ramp is, metres.
const RAMP_M: f64 = 5.0;

/// A thing that stands on the floor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Thing {
    /// A EUR pallet, its long side ahead.
    Pallet,
    /// The same, its short side ahead.
    PalletEnd,
    /// A pole of this many centimetres, 1 m high.
    Pole(u8),
    /// The legs of a table, 0.7 m high and 4 cm thick; 1.2 by 0.8 m.
    TableLegs,
    /// A person who lies across.
    LyingPerson,
}

impl Thing {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Pallet,
        Self::PalletEnd,
        Self::Pole(3),
        Self::Pole(5),
        Self::TableLegs,
        Self::LyingPerson,
    ];

    /// Its name.
    pub fn name(self) -> String {
        match self {
            Self::Pallet => "pallet, 1.2 m side".to_owned(),
            Self::PalletEnd => "pallet, 0.8 m side".to_owned(),
            Self::Pole(cm) => format!("pole of {cm} cm"),
            Self::TableLegs => "legs of a table".to_owned(),
            Self::LyingPerson => "lying person".to_owned(),
        }
    }

    /// Its solids; the nearest is this far ahead, metres.
    pub fn solids(self, ahead_m: f64) -> Vec<Solid> {
        match self {
            Self::Pallet => vec![cuboid([1.2, 0.8, 0.144], ahead_m, 0.0)],
            Self::PalletEnd => vec![cuboid([1.2, 0.8, 0.144], ahead_m, FRAC_PI_2)],
            Self::Pole(cm) => vec![cylinder(0.0, ahead_m, f64::from(cm) / 100.0, 1.0)],
            Self::TableLegs => [[-0.6, 0.0], [0.6, 0.0], [-0.6, 0.8], [0.6, 0.8]]
                .map(|[x, y]| cylinder(x, ahead_m + y, 0.04, 0.7))
                .to_vec(),
            Self::LyingPerson => vec![cuboid([1.7, 0.45, 0.25], ahead_m, 0.0)],
        }
    }
}

/// A box, turned by a quarter or not at all, whose near side is this far ahead.
fn cuboid(size_m: [f64; 3], ahead_m: f64, yaw_rad: f64) -> Solid {
    let depth_m = match yaw_rad == 0.0 {
        true => size_m[1],
        false => size_m[0],
    };
    Solid::Cuboid {
        middle_m: [0.0, ahead_m + depth_m / 2.0],
        size_m,
        yaw_rad,
    }
}

fn cylinder(x: f64, ahead_m: f64, thick_m: f64, height_m: f64) -> Solid {
    Solid::Cylinder {
        middle_m: [x, ahead_m + thick_m / 2.0],
        radius_m: thick_m / 2.0,
        height_m,
    }
}

/// A box 0.4 m wide and 0.3 m deep, this high, whose middle is this far ahead, metres.
pub fn small_box(height_m: f64, ahead_m: f64, yaw_rad: f64) -> Solid {
    Solid::Cuboid {
        middle_m: [0.0, ahead_m],
        size_m: [0.4, 0.3, height_m],
        yaw_rad,
    }
}

/// A ramp of 5 m that begins this far ahead, metres, and the level behind it: pieces 1 and 2. It goes
/// down where the slope is less than 0.
pub fn ramp(slope: f64, ahead_m: f64) -> Scene {
    let top = [ahead_m + RAMP_M, slope * RAMP_M];
    Scene::of_ground(Ground(vec![[ahead_m, 0.0], top]))
}

/// A kerb this far ahead, metres, and the pavement behind it: piece 2.
pub fn kerb(ahead_m: f64) -> Scene {
    Scene::of_ground(Ground(vec![[ahead_m, 0.0], [ahead_m, KERB_M]]))
}

/// An island as high as a kerb, 2 m wide, this far ahead, metres: piece 2.
pub fn island(ahead_m: f64) -> Scene {
    let (near, far) = (ahead_m, ahead_m + 2.0);
    Scene::of_ground(Ground(vec![
        [near, 0.0],
        [near, KERB_M],
        [far, KERB_M],
        [far, 0.0],
    ]))
}

/// A step down, so deep and this far ahead, metres, and the floor below it: piece 2.
pub fn step_down(deep_m: f64, ahead_m: f64) -> Scene {
    Scene::of_ground(Ground(vec![[ahead_m, 0.0], [ahead_m, -deep_m]]))
}
