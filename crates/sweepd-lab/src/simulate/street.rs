//! The street that the simulator drives in: a seeded scene of houses, parked and moving cars,
//! people, poles and trees.
//!
//! The road runs along y. From its middle outwards: a lane, a row of parked cars, the kerb, a
//! pavement with poles and trees, the house fronts. One side street leaves to the right ahead, one
//! to the left behind; a small park lies ahead on the left.
//!
//! ```text
//!   x -11.5      -6.3      -4.1        0        4.1      6.3      11.5
//!       | pavement | parked  |    lane  :  lane   | parked | pavement |
//! ```

use std::f64::consts::{FRAC_PI_2, PI};

use super::builder::Builder as Street;
use super::props::{self, GroundPose, House};
use super::scene::{GROUND, Scene, Surface};
use super::shape::Shape;

/// Where the middle of a lane is.
pub const LANE_M: f64 = 2.0;
const PARKED_M: f64 = 5.2;
const KERB_M: f64 = 6.3;
const FRONT_M: f64 = 11.5;
/// Height of a kerb.
const STEP_M: f64 = 0.14;
/// Length of the street, ahead and behind, metres.
const END_M: f64 = 110.0;
/// The side streets between house fronts: to the right ahead, to the left behind.
const RIGHT_STREET: [f64; 2] = [10.0, 20.0];
const LEFT_STREET: [f64; 2] = [-24.0, -14.0];
/// The park on the left.
const PARK: [f64; 2] = [14.0, 44.0];

/// A street like any other; each seed gives another one.
pub fn street(seed: u64) -> Scene {
    let mut street = Street::new(Scene::new([0.004, 0.012], 14), seed);
    for side in [-1.0, 1.0] {
        street.pavement(side);
        street.houses(side);
        street.parked_cars(side);
        street.street_furniture(side);
        street.people(side);
        street.side_street(side);
    }
    street.park();
    street.traffic();
    street.scene
}

/// The side street of a side of the road, from front to front.
fn opening(side: f64) -> [f64; 2] {
    if side > 0.0 {
        RIGHT_STREET
    } else {
        LEFT_STREET
    }
}

/// Whether a thing of this half length at y would stand in the mouth of the side street.
fn in_opening(side: f64, y: f64, half_m: f64) -> bool {
    let [start, end] = opening(side);
    y + half_m > start && y - half_m < end
}

impl Street {
    fn slab(&mut self, x: [f64; 2], y: [f64; 2]) {
        let base = [(x[0] + x[1]) / 2.0, (y[0] + y[1]) / 2.0, 0.0];
        let shape = Shape::cuboid(base, [(x[1] - x[0]).abs(), y[1] - y[0], STEP_M], 0.0);
        self.scene.extend(GROUND, [(shape, Surface::Plain(22))]);
    }

    /// The raised pavement of a side, open at the side street, and the narrow ones along that.
    fn pavement(&mut self, side: f64) {
        let [start, end] = opening(side);
        let x = [side * KERB_M, side * (FRONT_M + 1.6)];
        self.slab(x, [-END_M, start + 1.5]);
        self.slab(x, [end - 1.5, END_M]);
        let deep = [side * (FRONT_M + 1.6), side * 60.0];
        self.slab(deep, [start, start + 1.5]);
        self.slab(deep, [end - 1.5, end]);
    }

    fn house(&mut self, place: GroundPose, width_m: f64) {
        let house = House {
            width_m,
            depth_m: 11.0,
            height_m: self.between(8.0, 17.0),
            plaster: self.rng.u8(35..75),
            gateway: width_m > 10.0 && self.chance(0.25),
            bays: width_m > 9.0 && self.chance(0.35),
        };
        self.put(props::house(place, house));
    }

    /// House after house from one y to another, with a passage between some.
    fn houses(&mut self, side: f64) {
        let [start, end] = opening(side);
        let mut rows = vec![[-END_M, start], [end, END_M]];
        if side < 0.0 {
            rows = vec![[-END_M, start], [end, PARK[0]], [PARK[1], END_M]];
        }
        for [from, to] in rows {
            let mut y = from;
            while y < to - 4.0 {
                let wanted_m = self.between(8.0, 15.0);
                // If the rest is too short for another house, this one gets it.
                let width_m = if to - y - wanted_m < 7.0 {
                    to - y
                } else {
                    wanted_m
                };
                let corner = y == from || y + width_m == to;
                let setback_m = if corner {
                    0.0
                } else {
                    *self.rng.choice(&[0.0, 0.0, 0.5, 1.4]).unwrap_or(&0.0)
                };
                let place = GroundPose::new(
                    side * (FRONT_M + setback_m),
                    y + width_m / 2.0,
                    -side * FRAC_PI_2,
                );
                self.house(place, width_m);
                y += width_m;
                if !corner && self.chance(0.3) {
                    y += 2.5;
                }
            }
        }
    }

    /// The houses, cars and people of a side street, which runs along x.
    fn side_street(&mut self, side: f64) {
        let [start, end] = opening(side);
        let mut x = FRONT_M + 11.0;
        while x < 58.0 {
            let width_m = self.between(9.0, 14.0);
            for (y, heading_rad) in [(start - 0.2, 0.0), (end + 0.2, PI)] {
                self.house(
                    GroundPose::new(side * (x + width_m / 2.0), y, heading_rad),
                    width_m,
                );
            }
            x += width_m;
        }
        self.house(
            GroundPose::new(side * 72.0, (start + end) / 2.0, -side * FRAC_PI_2),
            20.0,
        );
        for x in [16.5, 22.4, 34.5] {
            let place = GroundPose::new(side * x, end - 2.7, side * FRAC_PI_2);
            let length_m = self.between(3.9, 4.7);
            let paint = self.paint();
            self.put(props::car(place, length_m, paint));
        }
        for x in [13.5, 18.0, 27.0] {
            let heading_rad = if self.chance(0.5) {
                FRAC_PI_2
            } else {
                -FRAC_PI_2
            };
            let place = GroundPose::new(side * x, start + 0.8, heading_rad).raised(STEP_M);
            self.walker(place);
        }
    }

    /// A row of parked cars with gaps, vans among them.
    fn parked_cars(&mut self, side: f64) {
        let mut y = -95.0 + self.between(0.0, 4.0);
        while y < 95.0 {
            let length_m = self.between(3.7, 4.8);
            let gap = self.chance(0.22);
            let van = self.chance(0.12);
            let askew_rad = self.between(-0.03, 0.03);
            let paint = self.paint();
            let x = side * PARKED_M + self.between(-0.12, 0.12);
            let heading_rad = if side > 0.0 { 0.0 } else { PI } + askew_rad;
            let place = GroundPose::new(x, y, heading_rad);
            // The sensor stands before a driveway: a car right beside it would hide a quarter of
            // the turn.
            let driveway = side > 0.0 && y.abs() < 4.5;
            if !gap && !driveway && !in_opening(side, y, 4.5) {
                if van {
                    self.put(props::van(place, paint.max(30)));
                } else {
                    self.put(props::car(place, length_m, paint));
                }
            }
            y += if van {
                6.6
            } else {
                length_m + self.between(0.9, 1.6)
            };
        }
    }

    /// Lamps, trees, signs and bins along the kerb.
    fn street_furniture(&mut self, side: f64) {
        let toward_road = -side * FRAC_PI_2;
        let mut y = -92.0 + if side > 0.0 { 0.0 } else { 11.0 };
        for index in 0.. {
            if y > 92.0 {
                break;
            }
            let place = GroundPose::new(side * (KERB_M + 0.5), y, toward_road).raised(STEP_M);
            if !in_opening(side, y, 1.5) {
                match index % 4 {
                    0 => self.put(props::lamp(place)),
                    2 if self.chance(0.6) => {
                        let sign = GroundPose {
                            heading_rad: PI,
                            ..place
                        };
                        self.put(props::sign(sign));
                    }
                    _ => {
                        let tree = GroundPose {
                            x: place.x + side * 0.3,
                            ..place
                        };
                        let size = self.between(0.8, 1.15);
                        self.put(props::tree(tree, size));
                    }
                }
            }
            y += self.between(6.0, 8.0);
        }
        let [start, end] = opening(side);
        for y in [start - 0.4, start + 0.9, end - 0.9, end + 0.4] {
            let place = GroundPose::new(side * (KERB_M + 0.3), y, toward_road).raised(STEP_M);
            self.put(props::bollard(place));
        }
        for y in [-58.0, -9.0, 24.0, 41.0].map(|y| y + 3.0 * side) {
            let place = GroundPose::new(side * (KERB_M + 0.6), y, toward_road).raised(STEP_M);
            self.put(props::bin(place));
        }
        let waiting = GroundPose::new(
            side * (KERB_M + 1.4),
            side * -18.0,
            if side > 0.0 { PI } else { 0.0 },
        );
        self.put(props::shelter(waiting.raised(STEP_M)));
    }

    /// People on the pavement, alone and in pairs.
    fn people(&mut self, side: f64) {
        let mut y = -45.0 + self.between(0.0, 3.0);
        while y < 50.0 {
            let heading_rad = if self.chance(0.5) { 0.0 } else { PI };
            let x = side * self.between(KERB_M + 1.4, FRONT_M - 0.6);
            let place = GroundPose::new(x, y, heading_rad).raised(STEP_M);
            if !in_opening(side, y, 1.0) {
                self.walker(place);
                if self.chance(0.3) {
                    self.walker(GroundPose {
                        x: x - side * 0.65,
                        y: y + 0.1,
                        ..place
                    });
                }
            }
            y += self.between(4.0, 9.0);
        }
    }

    /// Trees, hedges and benches on grass.
    fn park(&mut self) {
        let [start, end] = PARK;
        self.slab([-45.0, -FRONT_M - 1.6], [start, end]);
        let gate_m = 3.0;
        let half_m = (end - start - gate_m) / 2.0;
        for y in [start + half_m / 2.0, end - half_m / 2.0] {
            let place = GroundPose::new(-FRONT_M - 0.4, y, 0.0).raised(STEP_M);
            self.put(props::hedge(place, half_m));
        }
        for row in 0..4 {
            for column in 0..4 {
                let x = -14.0 - 7.0 * f64::from(row) + self.between(-2.0, 2.0);
                let y = start + 4.0 + 6.5 * f64::from(column) + self.between(-2.0, 2.0);
                let size = self.between(0.9, 1.5);
                let place = GroundPose::new(x, y, 0.0).raised(STEP_M);
                self.put(props::tree(place, size));
            }
        }
        for y in [start + 8.0, end - 8.0] {
            let place = GroundPose::new(-12.0, y, 0.0).raised(STEP_M);
            self.put(props::bench(place));
        }
    }

    /// Traffic: cars in both directions, a lorry, bicycles, a pedestrian who crosses the road.
    fn traffic(&mut self) {
        for (side, y, speed_m_s) in [
            (1.0, 13.5, 7.0),
            (1.0, 46.0, 9.0),
            (1.0, -17.0, 7.5),
            (-1.0, 8.5, 8.5),
            (-1.0, 58.0, 9.5),
            (-1.0, -44.0, 8.0),
        ] {
            let length_m = self.between(4.0, 4.7);
            let paint = self.paint();
            let place = in_lane(side, y);
            self.send(speed_m_s, props::car(place, length_m, paint));
        }
        let place = in_lane(-1.0, 29.0);
        self.send(7.0, props::lorry(place, 60));
        // Waiting to come out of the side street on the right.
        let place = GroundPose::new(KERB_M + 3.0, RIGHT_STREET[0] + 6.4, -FRAC_PI_2);
        self.put(props::car(place, 4.3, 40));
        for (place, speed_m_s) in [
            (GroundPose::new(3.5, 7.5, 0.0), 4.5),
            (GroundPose::new(-3.4, -12.0, PI), 5.0),
        ] {
            let clothes = self.rng.u8(20..70);
            self.send(speed_m_s, props::cyclist(place, clothes));
        }
        let crossing = GroundPose::new(-0.4, -7.0, FRAC_PI_2);
        self.send(1.3, props::person(crossing, 1.74, 30));
        let crossing = GroundPose::new(0.9, -7.6, FRAC_PI_2);
        self.send(1.3, props::person(crossing, 1.63, 45));
    }
}

/// A place in the middle of a lane, facing the way of its traffic.
fn in_lane(side: f64, y: f64) -> GroundPose {
    GroundPose::new(side * LANE_M, y, if side > 0.0 { 0.0 } else { PI })
}

#[cfg(test)]
mod tests {
    use super::super::scene::Class;
    use super::*;

    #[test]
    fn a_street_has_what_a_street_has() {
        let scene = street(1);
        let count = |class| {
            scene
                .objects()
                .iter()
                .filter(|object| object.class == class)
                .count()
        };
        let moving = scene
            .objects()
            .iter()
            .filter(|object| object.velocity.norm() > 0.0)
            .count();
        assert!(
            count(Class::Building) >= 25 && count(Class::Car) >= 30,
            "houses and cars"
        );
        assert!(
            count(Class::Person) >= 15 && count(Class::Cyclist) == 2 && count(Class::Lorry) >= 1,
            "who moves"
        );
        assert!(
            count(Class::Pole) >= 10 && count(Class::Tree) >= 15 && count(Class::Sign) >= 3,
            "what stands"
        );
        assert!(moving >= 20, "{moving} objects move");
        assert_eq!(count(Class::Ground), 1);
    }

    #[test]
    fn a_seed_gives_one_street_and_another_seed_another() {
        let text = |seed| format!("{:?}", street(seed));
        assert_eq!(text(5), text(5));
        assert_ne!(text(5), text(6));
    }
}
