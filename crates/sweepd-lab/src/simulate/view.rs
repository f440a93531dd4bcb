//! A scene as seen from the sensor: the solids to test for a ray, and its nearest hit.

use std::cmp::Ordering;

use fastrand::Rng;

use super::scene::{Hit, Scene, Surface};
use super::shape::{Bounds, Ray, Vec3, floor};

/// Sectors of a turn in the index of a [`View`].
const SECTORS: usize = 720;

/// Sectors a radian.
const PER_SECTOR: f64 = SECTORS as f64 / std::f64::consts::TAU;

/// Angle beside a beam within which solids are tested: twice the spread of any sensor's beams,
/// radians.
const RIM_RAD: f64 = 0.003;

/// Beams that go less far across than this for each metre along them meet the outlines of more
/// solids than [`RIM_RAD`] allows for: parts of such a beam may always meet something else.
const STEEP: f64 = 0.5;

/// Upper bound of the azimuth error of a curved ray, radians.
const ASTRAY_RAD: f64 = 0.000_1;

/// One solid as seen from the eye: conditions for a ray that may hit it.
#[derive(Clone, Copy)]
struct Candidate {
    solid: u32,
    moves: bool,
    /// Horizontal distance of its nearest place.
    near_m: f64,
    /// Horizontal distance of its farthest place.
    far_m: f64,
    /// Least and greatest rise of a ray that can meet it, metres a metre.
    rise: [f64; 2],
    /// Conditions for a ray in this sector.
    here: Within,
}

/// Necessary conditions for a ray of one sector to hit a solid or come near its outline; other rays
/// are not tested.
#[derive(Clone, Copy)]
struct Within {
    /// Horizontal distance that it must reach.
    near_m: f64,
    /// Least and greatest rise.
    rise: [f64; 2],
}

/// Properties of a solid besides its bounds.
#[derive(Clone, Copy)]
struct Traits {
    /// It is elsewhere in the next view.
    moves: bool,
    /// It needs random numbers, even if it is farther away than the nearest hit.
    by_chance: bool,
}

impl Candidate {
    /// Nearest first; at equal distance in the order of the scene.
    fn order(&self, other: &Self) -> Ordering {
        self.near_m
            .total_cmp(&other.near_m)
            .then(self.solid.cmp(&other.solid))
    }

    /// The candidates of a solid within these bounds, for each sector from which a ray can hit it.
    fn of(solid: u32, bounds: &Bounds, eye: Vec3, traits: Traits) -> Vec<(usize, Self)> {
        let [near_m, far_m] = bounds.reach(eye);
        let rise = [f64::NEG_INFINITY, f64::INFINITY];
        let here = Within { near_m, rise };
        let loose = Self {
            solid,
            moves: traits.moves,
            near_m,
            far_m,
            rise,
            here,
        };
        if near_m == 0.0 {
            return (0..SECTORS).map(|sector| (sector, loose)).collect();
        }
        let loose = Self {
            rise: rises(bounds.z, eye, [near_m, far_m]),
            ..loose
        };
        let (centre, edges) = bounds.azimuths(eye);
        let first = ((centre + (edges[0] - RIM_RAD)) * PER_SECTOR).floor() as i64;
        let last = ((centre + (edges[1] + RIM_RAD)) * PER_SECTOR).floor() as i64;
        let rim = bounds.grown(RIM_RAD * far_m);
        let mut candidates = Vec::new();
        for sector in first..=last {
            // Finer conditions for each sector do not pay for a view that is used only a few times.
            let here = if traits.moves {
                Some(here)
            } else {
                Within::of(&rim, eye, sector)
            };
            let Some(mut here) = here else { continue };
            if traits.by_chance {
                here.near_m = near_m;
            }
            candidates.push((wrapped(sector), Self { here, ..loose }));
        }
        candidates
    }
}

impl Within {
    /// Necessary conditions for a ray from the eye within a sector to hit something within bounds;
    /// `None` if none can.
    fn of(bounds: &Bounds, eye: Vec3, sector: i64) -> Option<Self> {
        let edges = [
            sector as f64 / PER_SECTOR - ASTRAY_RAD,
            (sector + 1) as f64 / PER_SECTOR + ASTRAY_RAD,
        ];
        let reach = bounds.reach_between(eye, edges)?;
        Some(Self {
            near_m: reach[0],
            rise: rises(bounds.z, eye, reach),
        })
    }
}

/// Least and greatest rise of a ray that can hit something between two heights and two horizontal
/// distances.
fn rises(z: [f64; 2], eye: Vec3, reach_m: [f64; 2]) -> [f64; 2] {
    let [near_m, far_m] = reach_m;
    let low = z[0] - eye.z;
    let high = z[1] - eye.z;
    [
        low / if low < 0.0 { near_m } else { far_m },
        high / if high > 0.0 { near_m } else { far_m },
    ]
}

/// The solids that move, or those that do not, by sector, as rays see them that start within a
/// margin of a levelled eye and within `half_s` seconds of a time.
fn candidates(
    scene: &Scene,
    moving: bool,
    eye: Vec3,
    margin_m: f64,
    time_s: f64,
    half_s: f64,
) -> impl Iterator<Item = (usize, Candidate)> {
    let solids = (0..).zip(scene.solids());
    solids
        .filter(move |(_, solid)| (scene.velocity(solid) != Vec3::zeros()) == moving)
        .flat_map(move |(index, solid)| {
            let velocity = scene.velocity(solid);
            let grown_m = margin_m + velocity.norm() * half_s;
            let mut bounds = solid.shape.bounds().grown(grown_m);
            bounds.centre[0] += velocity.x * time_s;
            bounds.centre[1] += velocity.y * time_s;
            let traits = Traits {
                moves: moving,
                by_chance: !matches!(solid.surface, Surface::Plain(_)),
            };
            Candidate::of(index, &bounds, eye, traits)
        })
}

/// The number of a sector within the turn.
fn wrapped(sector: i64) -> usize {
    sector.rem_euclid(SECTORS as i64) as usize
}

/// The sector of an azimuth. Most are within the turn, and need neither be rounded down nor
/// divided.
fn sector(azimuth_rad: f64) -> usize {
    let sectors = azimuth_rad * PER_SECTOR;
    if (0.0..SECTORS as f64).contains(&sectors) {
        sectors as usize
    } else {
        wrapped(floor(sectors) as i64)
    }
}

/// A scene from one place, over a short time: for each half degree the solids that can be there,
/// nearest first.
pub struct View<'a> {
    scene: &'a Scene,
    /// Where rays start.
    eye: Vec3,
    /// How far from the eye they may start, metres.
    margin_m: f64,
    /// What stands still, which is most: worked out once.
    fixed: Sectors,
    /// All of it, with what moves at the time of the view.
    sectors: Sectors,
    /// The sectors in which something moves.
    busy: Vec<usize>,
}

/// Candidates by sector.
type Sectors = Vec<Vec<Candidate>>;

impl<'a> View<'a> {
    /// The view of rays that start within `margin_m` of an eye and within `half_s` seconds of a
    /// time.
    pub fn new(scene: &'a Scene, eye: Vec3, margin_m: f64, time_s: f64, half_s: f64) -> Self {
        let mut fixed = vec![Vec::new(); SECTORS];
        let eye = scene.levelled(eye);
        for (sector, candidate) in candidates(scene, false, eye, margin_m, time_s, half_s) {
            fixed[sector].push(candidate);
        }
        for sector in &mut fixed {
            sector.sort_by(Candidate::order);
        }
        let mut view = Self {
            scene,
            eye,
            margin_m,
            sectors: fixed.clone(),
            fixed,
            busy: Vec::new(),
        };
        view.turn_to(time_s, half_s);
        view
    }

    /// Makes it the view within `half_s` seconds of another time.
    pub fn turn_to(&mut self, time_s: f64, half_s: f64) {
        for sector in self.busy.drain(..) {
            self.sectors[sector].clone_from(&self.fixed[sector]);
        }
        let moving = candidates(self.scene, true, self.eye, self.margin_m, time_s, half_s);
        for (index, candidate) in moving {
            let sector = &mut self.sectors[index];
            let place = sector.partition_point(|other| other.order(&candidate).is_lt());
            sector.insert(place, candidate);
            self.busy.push(index);
        }
    }

    /// The nearest thing that a ray meets within `max_m`. Chance decides about leaves and windows.
    pub fn cast(&self, ray: &Ray, time_s: f64, max_m: f64, rng: &mut Rng) -> Option<Hit> {
        self.look(ray, 0.0, time_s, max_m, rng).hit
    }

    /// The same of the middle of a beam, with whether the whole of it may meet something else: a
    /// cone about the ray of half an angle of `spread_rad`.
    pub fn look(&self, ray: &Ray, spread_rad: f64, time_s: f64, max_m: f64, rng: &mut Rng) -> Look {
        let sight = Sight::new(self.scene.bent(ray), spread_rad, time_s);
        let mut hit = self
            .scene
            .meet_ground(&sight.ray)
            .filter(|hit| hit.distance_m <= max_m);
        let mut limit_m = hit.map_or(max_m, |hit| hit.distance_m);
        let mut edge_m = f64::INFINITY;
        for candidate in &self.sectors[sector(ray.azimuth_rad)] {
            let limit_across_m = limit_m * sight.across;
            if candidate.near_m > limit_across_m {
                break;
            }
            if !sight.may_meet(candidate, limit_across_m) {
                continue;
            }
            let (outline_m, met) = self.meet(&sight, candidate, limit_m, rng);
            edge_m = edge_m.min(outline_m);
            if let Some(met) = met.filter(|met| met.distance_m < limit_m) {
                limit_m = met.distance_m;
                hit = Some(met);
            }
        }
        Look {
            hit,
            edge: edge_m <= limit_m || sight.across < STEEP,
        }
    }

    /// From where on the outline of a solid is within the beam, a number beyond all distances if it
    /// is not, and what the middle meets of it.
    #[inline]
    fn meet(
        &self,
        sight: &Sight,
        candidate: &Candidate,
        limit_m: f64,
        rng: &mut Rng,
    ) -> (f64, Option<Hit>) {
        let Sight {
            ray, spread_rad, ..
        } = sight;
        let solid = &self.scene.solids()[candidate.solid as usize];
        let moved;
        let ray = if candidate.moves {
            moved = self.scene.beside(solid, ray, sight.time_s);
            &moved
        } else {
            ray
        };
        let (outline_m, span) = if *spread_rad == 0.0 {
            (f64::INFINITY, solid.shape.span(ray))
        } else {
            let rim_m = spread_rad * (candidate.far_m / sight.across).min(limit_m);
            let Some(brim) = solid.shape.brim(ray, rim_m) else {
                return (f64::INFINITY, None);
            };
            (solid.outline_m(&brim, ray, rim_m), brim.span)
        };
        (
            outline_m,
            span.and_then(|span| self.scene.meet(solid, ray, &span, rng)),
        )
    }
}

/// A ray to look along, or the middle of a beam.
struct Sight {
    /// Where the ground is level.
    ray: Ray,
    spread_rad: f64,
    time_s: f64,
    /// What it goes across for each metre along it.
    across: f64,
    /// What it rises for each metre across.
    rise: f64,
    /// What a rise of the beam's rim adds, and with it the growth of the solids at their farthest.
    slack: f64,
}

impl Sight {
    fn new(ray: Ray, spread_rad: f64, time_s: f64) -> Self {
        let across = ray.direction.xy().norm();
        let rise = ray.direction.z / across;
        Self {
            ray,
            spread_rad,
            time_s,
            across,
            rise,
            slack: spread_rad * (1.0 + rise * rise),
        }
    }

    /// Whether it may hit a solid, or come near its outline, within this horizontal distance.
    #[inline]
    fn may_meet(&self, candidate: &Candidate, limit_across_m: f64) -> bool {
        let Self { rise, slack, .. } = *self;
        let here = &candidate.here;
        let [low, high] = candidate.rise;
        // The first turns down most.
        rise >= here.rise[0]
            && rise <= here.rise[1]
            && here.near_m <= limit_across_m
            && rise >= low - slack
            && rise <= high + slack
    }
}

/// What the middle of a beam met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// The nearest thing on the ray.
    pub hit: Option<Hit>,
    /// An edge, or leaves, are within the beam: parts of it may meet something else.
    pub edge: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::scene::{Class, GROUND, WINDOW_RECESS_M};
    use crate::simulate::shape::Shape;
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_6, PI};

    fn cast(scene: &Scene, ray: &Ray, time_s: f64) -> Option<Hit> {
        let view = View::new(scene, ray.origin, 0.01, time_s, 0.01);
        view.cast(ray, time_s, 100.0, &mut Rng::with_seed(0))
    }

    const EYE: Vec3 = Vec3::new(0.0, 0.0, 2.0);

    #[test]
    fn level_ground_is_met_at_height_over_sine() {
        let scene = Scene::new([0.0; 2], 20);
        let hit = cast(&scene, &Ray::new(EYE, 1.0, -FRAC_PI_6), 0.0).unwrap();
        assert!((hit.distance_m - 4.0).abs() < 1e-12 && (hit.cos_incidence - 0.5).abs() < 1e-12);
        assert_eq!(
            (hit.object, hit.class, hit.reflectivity),
            (GROUND, Class::Ground, 20)
        );
        assert_eq!(cast(&scene, &Ray::new(EYE, 1.0, 0.0), 0.0), None);
        assert_eq!(
            cast(&scene, &Ray::new(EYE, 1.0, -0.01), 0.0),
            None,
            "200 m away"
        );
    }

    #[test]
    fn rising_ground_is_met_sooner_and_things_stand_on_it() {
        let mut scene = Scene::new([0.0, 0.05], 20);
        scene.add(
            Class::Pole,
            Vec3::zeros(),
            [(
                Shape::cylinder([0.0, 20.0, 0.0], 0.5, 1.5),
                Surface::Plain(30),
            )],
        );
        // z = 2 - s sin w = 0.05 s cos w
        let (sin, cos) = 0.1_f64.sin_cos();
        let ground = cast(&scene, &Ray::new(EYE, 0.0, -0.1), 0.0).unwrap();
        assert!((ground.distance_m - 2.0 / (sin + 0.05 * cos)).abs() < 1e-12);
        // At y = 20 the ground is 1 m high, the pole's top 2.5 m: a level ray at 2 m meets it, one
        // at 2.6 m does not.
        assert!(
            (cast(&scene, &Ray::new(EYE, 0.0, 0.0), 0.0)
                .unwrap()
                .distance_m
                - 19.5)
                .abs()
                < 1e-12
        );
        let above = Ray::new(EYE + Vec3::z() * 0.6, 0.0, 0.0);
        assert_ne!(
            cast(&scene, &above, 0.0).map(|hit| hit.class),
            Some(Class::Pole)
        );
    }

    /// One of the kinds, of up to some metres, within 40 m.
    fn shape_somewhere(rng: &mut Rng) -> Shape {
        let place = [rng.f64() * 80.0 - 40.0, rng.f64() * 80.0 - 40.0, rng.f64()];
        let size = [
            0.2 + rng.f64() * 2.0,
            0.2 + rng.f64() * 4.0,
            0.2 + rng.f64() * 4.0,
        ];
        match rng.u8(0..3) {
            0 => Shape::cuboid(place, size, rng.f64() * 7.0),
            1 => Shape::cylinder(place, size[0], size[2]),
            _ => Shape::ellipsoid(place, size),
        }
    }

    #[test]
    fn the_nearest_of_many_is_found_as_by_trying_all() {
        let mut rng = Rng::with_seed(7);
        let mut scene = Scene::new([0.01, -0.02], 20);
        for _ in 0..300 {
            let shape = shape_somewhere(&mut rng);
            // The eye is never inside: a span counts only when the ray comes from outside.
            let velocity = Vec3::new(rng.f64() * 4.0 - 2.0, rng.f64() * 4.0 - 2.0, 0.0);
            scene.add(Class::Furniture, velocity, [(shape, Surface::Plain(50))]);
        }
        let (time_s, half_s) = (1.5, 0.02);
        let view = View::new(&scene, EYE, 0.03, time_s, half_s);
        for _ in 0..20_000 {
            let origin = EYE + Vec3::z() * ((rng.f64() - 0.5) * 0.04);
            let ray = Ray::new(origin, rng.f64() * 7.0 - 0.5, (rng.f64() - 0.6) * 0.6);
            let at_s = time_s + (rng.f64() - 0.5) * 2.0 * half_s;
            let bent = scene.bent(&ray);
            let all = scene.solids().iter().filter_map(|solid| {
                let ray = scene.beside(solid, &bent, at_s);
                scene.meet(
                    solid,
                    &ray,
                    &solid.shape.span(&ray)?,
                    &mut Rng::with_seed(0),
                )
            });
            let naive = all
                .chain(scene.meet_ground(&bent))
                .filter(|hit| hit.distance_m < 100.0)
                .min_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
            assert_eq!(view.cast(&ray, at_s, 100.0, &mut Rng::with_seed(0)), naive);
        }
    }

    #[test]
    fn a_view_that_turns_to_another_time_is_that_of_then() {
        let scene = crate::simulate::street::street(3);
        let mut rng = Rng::with_seed(8);
        let mut view = View::new(&scene, EYE, 0.03, 0.0, 0.01);
        for time_s in [7.0, 0.5, 3.0] {
            view.turn_to(time_s, 0.01);
            let then = View::new(&scene, EYE, 0.03, time_s, 0.01);
            for seed in 0..2_000 {
                let ray = Ray::new(EYE, rng.f64() * 6.2, (rng.f64() - 0.6) * 0.6);
                let look = |view: &View<'_>| {
                    view.look(&ray, 0.001_5, time_s, 100.0, &mut Rng::with_seed(seed))
                };
                assert_eq!(look(&view), look(&then));
            }
        }
    }

    #[test]
    fn away_from_edges_the_whole_beam_hits_what_its_middle_hits() {
        let mut rng = Rng::with_seed(9);
        let mut scene = Scene::new([0.01, -0.02], 20);
        for _ in 0..200 {
            scene.add(
                Class::Furniture,
                Vec3::zeros(),
                [(shape_somewhere(&mut rng), Surface::Plain(50))],
            );
        }
        let (view, spread_rad) = (View::new(&scene, EYE, 0.03, 0.0, 0.01), 0.001_5);
        let (mut edges, mut missed) = (0, 0);
        let dice = &mut Rng::with_seed(0);
        for _ in 0..20_000 {
            let (azimuth_rad, elevation_rad) = (rng.f64() * 7.0, (rng.f64() - 0.6) * 0.6);
            let look = view.look(
                &Ray::new(EYE, azimuth_rad, elevation_rad),
                spread_rad,
                0.0,
                60.0,
                dice,
            );
            let range_m = |hit: Option<Hit>| hit.map_or(60.0, |hit| hit.distance_m);
            let object = |hit: Option<Hit>| hit.map(|hit| hit.object);
            let differs = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
                .into_iter()
                .any(|(across, up)| {
                    let (across, up) = (0.8 * spread_rad * across, 0.8 * spread_rad * up);
                    let hit = view.cast(
                        &Ray::new(EYE, azimuth_rad + across, elevation_rad + up),
                        0.0,
                        60.0,
                        dice,
                    );
                    object(hit) != object(look.hit)
                        && (range_m(hit) - range_m(look.hit)).abs() > 0.3
                });
            // Ground that ends at the greatest range is no edge.
            let horizon = look
                .hit
                .is_none_or(|hit| hit.object == GROUND && hit.distance_m > 40.0);
            edges += usize::from(look.edge);
            missed += usize::from(differs && !look.edge && !horizon);
        }
        // Of the foot of a thing the ground before it is no edge: there is no step in range but
        // where it is flat.
        assert!(
            (200..4_000).contains(&edges) && missed * 50 < edges,
            "{edges} {missed}"
        );
    }

    #[test]
    fn what_moves_is_elsewhere_later() {
        let mut scene = Scene::new([0.0; 2], 20);
        let car = Shape::cuboid([0.0, 10.0, 0.0], [2.0, 4.0, 3.0], 0.0);
        let number = scene.add(
            Class::Car,
            Vec3::new(0.0, 5.0, 0.0),
            [(car, Surface::Plain(50))],
        );
        let ahead = Ray::new(EYE, 0.0, 0.0);
        assert!((cast(&scene, &ahead, 0.0).unwrap().distance_m - 8.0).abs() < 1e-12);
        let later = cast(&scene, &ahead, 2.0).unwrap();
        assert!((later.distance_m - 18.0).abs() < 1e-12 && later.object == number);
        assert_eq!(cast(&scene, &Ray::new(EYE, PI, 0.0), 2.0), None);
    }

    #[test]
    fn leaves_stop_one_in_e_rays_at_their_free_path() {
        let mut scene = Scene::new([0.0; 2], 20);
        let leaves = Surface::Leaves {
            reflectivity: 30,
            free_path_m: 2.0,
        };
        scene.add(
            Class::Tree,
            Vec3::zeros(),
            [(Shape::ellipsoid([10.0, 0.0, 2.0], [1.0; 3]), leaves)],
        );
        let view = View::new(&scene, EYE, 0.01, 0.0, 0.01);
        let mut rng = Rng::with_seed(3);
        let through = (0..10_000)
            .filter(|_| {
                view.cast(&Ray::new(EYE, FRAC_PI_2, 0.0), 0.0, 100.0, &mut rng)
                    .is_none()
            })
            .count();
        // 2 m of leaves with a free path of 2 m: exp(-1) = 36.8 % get through, standard deviation
        // 48.
        assert!((3_530..3_830).contains(&through), "{through}");
    }

    #[test]
    fn windows_lie_behind_the_wall() {
        let mut scene = Scene::new([0.0; 2], 20);
        let house = Shape::cuboid([0.0, 15.0, 0.0], [40.0, 10.0, 12.0], 0.0);
        scene.add(
            Class::Building,
            Vec3::zeros(),
            [(house, Surface::Windows(40))],
        );
        let behind = |hit: Hit, ray: &Ray| ray.at(hit.distance_m).y - 10.0;
        let mut seen = [0; 2];
        for k in 0..400 {
            let ray = Ray::new(EYE, f64::from(k - 200) * 0.004, 0.02);
            let hit = cast(&scene, &ray, 0.0).unwrap();
            let window = hit.reflectivity < 40;
            seen[usize::from(window)] += 1;
            let expected = if window { WINDOW_RECESS_M } else { 0.0 };
            assert!((behind(hit, &ray) - expected).abs() < 1e-9);
        }
        assert!(seen.iter().all(|&n| n > 100), "{seen:?}");
    }
}
