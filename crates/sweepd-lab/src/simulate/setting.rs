//! The kinds of scenes, and the pose of a sensor in each.

use super::corridor::corridor;
use super::field::field;
use super::head::Pose;
use super::parking::parking_lot;
use super::room::room;
use super::scene::Scene;
use super::shape::Vec3;
use super::street::{self, street};
use super::warehouse::warehouse;
use sweepd_core::segment::Mount;

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
    /// A corridor indoors.
    Corridor,
    /// A warehouse with racks and pallets.
    Warehouse,
}

impl Setting {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Street,
        Self::ParkingLot,
        Self::Field,
        Self::Room,
        Self::Corridor,
        Self::Warehouse,
    ];

    /// The word for it on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Street => "street",
            Self::ParkingLot => "parking-lot",
            Self::Field => "field",
            Self::Room => "room",
            Self::Corridor => "corridor",
            Self::Warehouse => "warehouse",
        }
    }

    /// What is there, for people who choose.
    pub fn about(self) -> &'static str {
        match self {
            Self::Street => "Houses, cars, people; ground that rises by 0.7 degrees ahead",
            Self::ParkingLot => "Rows of cars; ground that slopes by 0.4 degrees",
            Self::Field => "A fence, trees, bushes; ground that slopes by up to 1.4 degrees",
            Self::Room => "Tables, shelves, pillars, people; a level floor",
            Self::Corridor => "Doors, pillars, people, boxes and a pallet; a level floor",
            Self::Warehouse => "Racks, EUR pallets, a forklift, people; a level floor",
        }
    }

    /// The scene of a seed.
    pub fn build(self, seed: u64) -> Scene {
        match self {
            Self::Street => street(seed),
            Self::ParkingLot => parking_lot(seed),
            Self::Field => field(seed),
            Self::Room => room(seed),
            Self::Corridor => corridor(seed),
            Self::Warehouse => warehouse(seed),
        }
    }

    /// Pose of a sensor: upright, on the roof of a car, indoors on a robot. Further sensors, counted from 0,
    /// are beside the first, alternately to its right and left.
    pub fn pose(self, number: usize) -> Pose {
        let (x, height_m) = match self {
            Self::Street => (street::LANE_M, 1.9),
            Self::ParkingLot | Self::Field => (0.0, 1.9),
            Self::Room => (0.0, 0.9),
            Self::Corridor | Self::Warehouse => (0.0, 0.4),
        };
        let away_m = 0.1 * number.div_ceil(2) as f64;
        let beside_m = if number % 2 == 1 { away_m } else { -away_m };
        Pose::upright(Vec3::new(x + beside_m, 0.0, height_m))
    }

    /// The same with the tilt of a mount, and at its height above the ground if it has one.
    ///
    /// # Errors
    /// A message: the sensor would be in or over a thing of the scene.
    pub fn mounted(self, scene: &Scene, number: usize, mount: &Mount) -> Result<Pose, String> {
        let pose = self.pose(number);
        let mut pose = pose.tilted(mount.pitch_rad.into(), mount.roll_rad.into());
        if let Some(height_m) = mount.height_m {
            pose.origin.z += f64::from(height_m) - scene.levelled(pose.origin).z;
        }
        let Some(class) = scene.below(pose.origin) else {
            return Ok(pose);
        };
        Err(format!(
            "sensor {} would be {:.2} m above the ground of the {}, in or over something ({})",
            number + 1,
            scene.levelled(pose.origin).z,
            self.name(),
            class.name(),
        ))
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
        assert!(
            count(Setting::Corridor, Class::Building) >= Some(20)
                && count(Setting::Corridor, Class::Furniture) >= Some(6)
                && count(Setting::Corridor, Class::Person) >= Some(2)
                && count(Setting::Corridor, Class::Pallet) >= Some(1)
        );
        assert!(
            count(Setting::Warehouse, Class::Pallet) >= Some(100)
                && count(Setting::Warehouse, Class::Furniture) >= Some(8)
                && count(Setting::Warehouse, Class::Person) >= Some(2)
                && count(Setting::Warehouse, Class::Lorry) == Some(1)
        );
    }

    #[test]
    fn a_height_is_above_the_ground_below_and_must_leave_the_sensor_in_the_open() {
        for setting in Setting::ALL {
            let scene = setting.build(1);
            let mounted = |height_m: f32, number| {
                let mount = Mount {
                    height_m: Some(height_m),
                    ..Mount::default()
                };
                setting.mounted(&scene, number, &mount)
            };
            for number in 0..9 {
                let pose = mounted(0.5, number).unwrap();
                assert!((scene.levelled(pose.origin).z - 0.5).abs() < 1e-6);
                let default = setting.mounted(&scene, number, &Mount::default());
                assert_eq!(default, Ok(setting.pose(number)));
            }
            let has_ceiling = !matches!(
                setting,
                Setting::Street | Setting::ParkingLot | Setting::Field
            );
            // In the ceiling, and above it: 2.4 to 8 m are all heights of it.
            for height_m in [8.0, 50.0] {
                let message = mounted(height_m, 0).err();
                assert_eq!(message.is_some(), has_ceiling, "{}", setting.name());
                assert!(message.is_none_or(|message| message.contains("(building)")));
            }
        }
        // In the wall beside.
        let corridor = Setting::Corridor.build(1);
        let mount = Mount::default();
        let mut poses = (0..54).map(|number| Setting::Corridor.mounted(&corridor, number, &mount));
        assert!(poses.any(|pose| pose.is_err()));
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
