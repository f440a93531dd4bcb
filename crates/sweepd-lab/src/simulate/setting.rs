//! The kinds of scenes, and the pose of a sensor in each.

use super::field::field;
use super::head::Pose;
use super::parking::parking_lot;
use super::room::room;
use super::scene::Scene;
use super::shape::Vec3;
use super::street::{self, street};

/// A kind of scene; a seed makes one of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Setting {
    /// An urban street.
    Street,
    /// A parking lot of a supermarket.
    ParkingLot,
    /// A field with next to nothing on it.
    Field,
    /// A hall indoors.
    Room,
}

impl Setting {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Street, Self::ParkingLot, Self::Field, Self::Room];

    /// The word for it on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Street => "street",
            Self::ParkingLot => "parking-lot",
            Self::Field => "field",
            Self::Room => "room",
        }
    }

    /// The scene of a seed.
    pub fn build(self, seed: u64) -> Scene {
        match self {
            Self::Street => street(seed),
            Self::ParkingLot => parking_lot(seed),
            Self::Field => field(seed),
            Self::Room => room(seed),
        }
    }

    /// Pose of a sensor: on the roof of a car, indoors on a robot. Further sensors, counted from 0,
    /// are beside the first, alternately to its right and left.
    pub fn pose(self, number: usize) -> Pose {
        let (x, height_m) = match self {
            Self::Street => (street::LANE_M, 1.9),
            Self::ParkingLot | Self::Field => (0.0, 1.9),
            Self::Room => (0.0, 0.9),
        };
        let away_m = 0.1 * number.div_ceil(2) as f64;
        let beside_m = if number % 2 == 1 { away_m } else { -away_m };
        Pose {
            origin: Vec3::new(x + beside_m, 0.0, height_m),
            heading_rad: 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::Class;

    #[test]
    fn a_seed_gives_one_scene_and_another_seed_another() {
        for setting in Setting::ALL {
            let text = |seed| format!("{:?}", setting.build(seed));
            assert_eq!(text(5), text(5));
            assert_ne!(text(5), text(6), "{}", setting.name());
        }
    }

    #[test]
    fn each_scene_has_what_makes_it_one() {
        let count = |setting: Setting, class| {
            (1..20)
                .map(|seed| {
                    setting
                        .build(seed)
                        .objects()
                        .iter()
                        .filter(|object| object.class == class)
                        .count()
                })
                .min()
        };
        assert!(count(Setting::ParkingLot, Class::Car) >= Some(60));
        assert!(count(Setting::ParkingLot, Class::Building) >= Some(1));
        assert!(count(Setting::Field, Class::Tree) >= Some(3));
        assert_eq!(count(Setting::Field, Class::Building), Some(0));
        assert!(
            count(Setting::Room, Class::Building) >= Some(9),
            "walls, ceiling, pillars"
        );
        assert!(
            count(Setting::Room, Class::Furniture) >= Some(8)
                && count(Setting::Room, Class::Person) >= Some(2)
        );
    }

    #[test]
    fn nothing_stands_where_the_sensors_are() {
        for (setting, seed) in Setting::ALL
            .into_iter()
            .flat_map(|setting| (1..30).map(move |seed| (setting, seed)))
        {
            let scene = setting.build(seed);
            for number in 0..9 {
                let eye = setting.pose(number).origin;
                // What hangs above, as a ceiling does, may.
                let near = |part: &&crate::simulate::scene::Solid| {
                    let bounds = part.shape.bounds();
                    bounds.reach(eye)[0] < 0.5 && bounds.z[0] < eye.z + 0.5
                };
                assert!(
                    scene.solids().iter().find(near).is_none(),
                    "{} {seed} {number}",
                    setting.name()
                );
            }
        }
    }
}
