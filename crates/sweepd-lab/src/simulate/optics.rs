//! From surfaces to reported returns: spread of the beam, several returns, weak returns, noise.

use fastrand::Rng;

use super::beam::Aim;
use super::head::Pose;
use super::scene::{Class, Hit};
use super::shape::{Ray, Vec3};
use super::view::{Look, View};
use sweepd_core::sensor::Model;
use sweepd_core::wire::data::{Record, ReturnMode};

/// Properties of lasers and receiver.
#[derive(Clone, Copy, Debug)]
pub struct Optics {
    /// Nearer than this nothing is reported, metres.
    pub min_range_m: f64,
    /// A surface of reflectivity 50 is seen half of the time from here, metres; nothing is reported
    /// beyond.
    pub max_range_m: f64,
    /// Standard deviation of the range, metres.
    pub noise_m: f64,
    /// Share of shots without a return for no visible reason.
    pub dropout: f64,
    /// Half the angle of the cone that a beam lights, radians.
    pub spread_rad: f64,
}

impl Optics {
    /// Those of a model, from its data sheet.
    pub fn of(model: Model) -> Self {
        let (min_range_m, max_range_m) = match model {
            Model::Vlp16 | Model::PuckLite | Model::PuckHiRes => (0.4, 100.0),
            Model::Hdl32e => (0.4, 80.0),
            Model::Hdl64eS2 | Model::Hdl64eS3 => (0.9, 120.0),
            Model::Vlp32c => (0.5, 200.0),
            Model::Vls128 => (1.0, 245.0),
        };
        Self {
            min_range_m,
            max_range_m,
            noise_m: 0.01,
            dropout: 0.004,
            spread_rad: 0.0015,
        }
    }

    /// An instrument without flaws: every hit within range is reported, where it is.
    pub fn perfect(max_range_m: f64) -> Self {
        Self {
            min_range_m: 0.0,
            max_range_m,
            noise_m: 0.0,
            dropout: 0.0,
            spread_rad: 0.0,
        }
    }

    /// Whether the instrument has no flaws, so that no random numbers are needed.
    fn is_perfect(&self) -> bool {
        self.dropout == 0.0 && self.noise_m == 0.0
    }
}

/// One return: what was met, and how much light came back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Return {
    /// The point that returned most of the light; its distance is the weighted one.
    pub hit: Hit,
    /// Total light; the receiver detects 1 half of the time.
    pub signal: f64,
    /// The distance in the packet that means this place, before noise and rounding, metres.
    pub distance_m: f64,
}

/// Light that comes back from one surface, before the receiver.
#[derive(Clone, Copy, Debug)]
struct Pulse {
    hit: Hit,
    /// As in [`Return`].
    signal: f64,
}

impl Pulse {
    fn new(hit: Hit, signal: f64) -> Self {
        Self { hit, signal }
    }
}

/// A shot of one beam: where it starts and points, and when.
#[derive(Clone, Copy, Debug)]
pub struct Shot<'a> {
    /// The beam, in the sensor's frame.
    pub aim: Aim<'a>,
    /// Where the sensor stands.
    pub pose: &'a Pose,
    /// When, seconds after the start.
    pub time_s: f64,
    /// About the distance in the packet, metres: where a curved beam is first looked along.
    pub guess_m: f64,
}

impl Shot<'_> {
    fn ray(&self, direction: Vec3, azimuth_rad: f64) -> Ray {
        let direction = self.pose.turned(direction);
        Ray {
            origin: self.pose.origin + self.pose.turned(self.aim.origin),
            direction,
            azimuth_rad: match self.pose.tilt {
                None => azimuth_rad + self.pose.heading_rad,
                Some(_) => direction.x.atan2(direction.y),
            },
        }
    }
}

/// The rays of a beam: across and up in units of its spread, and the share of its light.
const FOOTPRINT: [(f64, f64, f64); 5] = [
    (0.0, 0.0, 0.4),
    (0.8, 0.0, 0.15),
    (-0.8, 0.0, 0.15),
    (0.0, 0.8, 0.15),
    (0.0, -0.8, 0.15),
];

/// Pulses nearer to each other than this are one return, metres.
const RESOLUTION_M: f64 = 0.8;

/// The returns that a shot gives, one for each block that reports it: `[only]` or, in dual mode,
/// `[last, strong]`.
///
/// Dual (VLP-16 User Manual, section 6.2): the last, and the strongest, or the second strongest if
/// the strongest is the last.
pub fn shoot(
    optics: &Optics,
    view: &View<'_>,
    shot: &Shot<'_>,
    mode: ReturnMode,
    rng: &mut Rng,
) -> [Option<Return>; 2] {
    let centre = cast(optics, view, shot, 0.0, 0.0, rng);
    if !centre.edge {
        // Only the middle of the beam is cast, which takes a fifth of the time.
        let only = centre
            .hit
            .map(|hit| Pulse::new(hit, signal(optics, &hit)))
            .filter(|pulse| is_seen(optics, pulse.signal, rng))
            .and_then(|pulse| sayable(&shot.aim, pulse));
        return [only, only.filter(|_| mode == ReturnMode::Dual)];
    }
    let met = met(optics, view, shot, centre.hit, rng);
    let mut returns: Vec<Return> = Vec::with_capacity(met.len());
    for pulse in met.chunk_by(is_one_pulse).filter_map(merged) {
        if is_seen(optics, pulse.signal, rng) {
            returns.extend(sayable(&shot.aim, pulse));
        }
    }
    let last = returns.last().copied();
    returns.sort_by(|a, b| b.signal.total_cmp(&a.signal));
    match mode {
        ReturnMode::Dual if returns.first().copied() == last => {
            [last, returns.get(1).copied().or(last)]
        }
        ReturnMode::Dual => [last, returns.first().copied()],
        ReturnMode::Strongest => [returns.first().copied(), None],
        ReturnMode::Last => [last, None],
    }
}

/// Tolerance for the intersection of a curved beam with a surface, metres.
const BESIDE_M: f64 = 0.001;
/// Most rays that are cast along a curved beam; then the last one counts, since leaves are random
/// in each cast.
const MOST_CASTS: usize = 4;

/// What a part of the beam meets, this many radians across and up from its middle.
fn cast(
    optics: &Optics,
    view: &View<'_>,
    shot: &Shot<'_>,
    across: f64,
    up: f64,
    rng: &mut Rng,
) -> Look {
    let aim = &shot.aim;
    let is_centre = (across, up) == (0.0, 0.0);
    let spread_rad = if is_centre { optics.spread_rad } else { 0.0 };
    let mut towards = aim.towards(shot.guess_m);
    for casts in 1.. {
        let (direction, azimuth_rad) = if is_centre {
            towards
        } else {
            aim.beside(towards.0, towards.1, across, up)
        };
        let ray = shot.ray(direction, azimuth_rad);
        let mut look = view.look(&ray, spread_rad, shot.time_s, optics.max_range_m, rng);
        let range_m = look.hit.map_or(optics.max_range_m, |hit| hit.distance_m);
        if casts < MOST_CASTS && !(casts == 1 && aim.goes_by(shot.guess_m, range_m, BESIDE_M)) {
            let better = aim.towards_range(range_m);
            if (better.0 - towards.0).norm() * range_m > BESIDE_M {
                towards = better;
                continue;
            }
        }
        look.hit = look.hit.filter(|hit| hit.distance_m >= optics.min_range_m);
        return look;
    }
    unreachable!("the loop ends with the last cast")
}

/// A return that a packet can represent: `None` if 16 bits cannot hold its distance, else the
/// nearest representable range.
fn sayable(aim: &Aim<'_>, pulse: Pulse) -> Option<Return> {
    let Pulse { mut hit, signal } = pulse;
    let distance_m = aim.distance_m(hit.distance_m);
    if aim.is_curved() {
        hit.distance_m = aim.vector(distance_m).norm();
    }
    aim.is_sayable(distance_m).then_some(Return {
        hit,
        signal,
        distance_m,
    })
}

/// What the rays of the whole beam meet, nearest first, each with its light.
fn met(
    optics: &Optics,
    view: &View<'_>,
    shot: &Shot<'_>,
    centre: Option<Hit>,
    rng: &mut Rng,
) -> Vec<Pulse> {
    let mut met: Vec<Pulse> = Vec::with_capacity(FOOTPRINT.len());
    for (across, up, share) in FOOTPRINT {
        let across = across * optics.spread_rad;
        let up = up * optics.spread_rad;
        let hit = if (across, up) == (0.0, 0.0) {
            centre
        } else {
            cast(optics, view, shot, across, up, rng).hit
        };
        met.extend(hit.map(|hit| Pulse::new(hit, share * signal(optics, &hit))));
    }
    met.sort_by(|a, b| a.hit.distance_m.total_cmp(&b.hit.distance_m));
    met
}

/// Whether the receiver merges two consecutive pulses. The merged pulse is at the weighted mean of
/// its surfaces.
fn is_one_pulse(a: &Pulse, b: &Pulse) -> bool {
    // Ground under a flat beam gives one long pulse.
    let ground = a.hit.class == Class::Ground && b.hit.class == Class::Ground;
    b.hit.distance_m - a.hit.distance_m < RESOLUTION_M || ground
}

/// One pulse of several that the receiver cannot separate.
fn merged(parts: &[Pulse]) -> Option<Pulse> {
    let brightest = parts.iter().max_by(|a, b| a.signal.total_cmp(&b.signal))?;
    let mut hit = brightest.hit;
    let signal: f64 = parts.iter().map(|part| part.signal).sum();
    // The receiver times the peak of a long pulse; glass that mirrored everything away has no light
    // to weight by.
    if signal > 0.0 && parts.iter().any(|part| part.hit.class != Class::Ground) {
        hit.distance_m = parts
            .iter()
            .map(|part| part.signal * part.hit.distance_m)
            .sum::<f64>()
            / signal;
    }
    Some(Pulse::new(hit, signal))
}

/// Light that comes back from a whole beam on this surface, by distance, reflectivity and
/// incidence.
fn signal(optics: &Optics, hit: &Hit) -> f64 {
    let diffuse = f64::from(hit.reflectivity.min(100)) / 50.0;
    let retro = 1.0 + f64::from(hit.reflectivity.saturating_sub(100)) / 10.0;
    // Real surfaces are rough: even a grazing beam meets facets that face it.
    let facing = 0.3 + 0.7 * hit.cos_incidence;
    diffuse * retro * facing * (optics.max_range_m / hit.distance_m).powi(2)
}

fn is_seen(optics: &Optics, signal: f64, rng: &mut Rng) -> bool {
    // From 0.6 to 1.4 of the signal that is seen half of the time.
    optics.is_perfect() || (rng.f64() >= optics.dropout && rng.f64() < (signal - 0.6) / 0.8)
}

/// The three bytes that report a return, with the noise of range and reflectivity.
pub fn record(optics: &Optics, one: &Return, aim: &Aim<'_>, rng: &mut Rng) -> Record {
    let Return {
        hit, distance_m, ..
    } = one;
    let noise_m = if optics.noise_m == 0.0 {
        0.0
    } else {
        optics.noise_m * gaussian(rng)
    };
    // A return is reported even where the noise pushes it below the first unit.
    let units = aim
        .units(*distance_m, noise_m)
        .clamp(1.0, f64::from(u16::MAX));
    let blur = if optics.is_perfect() {
        0
    } else {
        rng.i16(-2..=2)
    };
    let (low, high) = if hit.reflectivity > 100 {
        (101, 255)
    } else {
        (0, 100)
    };
    let reflectivity = (i16::from(hit.reflectivity) + blur).clamp(low, high) as u8;
    let reflectivity = aim.intensity_byte(units, reflectivity);
    Record {
        distance: (units as u16).into(),
        reflectivity,
    }
}

/// A normally distributed number (Box and Muller).
fn gaussian(rng: &mut Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.f64()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.f64()).cos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::beam::Laser;
    use crate::simulate::scene::{Scene, Surface};
    use crate::simulate::shape::Shape;
    use sweepd_core::sensor::Beam;

    /// A level beam.
    fn laser() -> Laser {
        Laser::new(&Beam::ideal(0, 0.0), 0.002)
    }

    const EYE: Vec3 = Vec3::new(0.0, 0.0, 2.0);

    /// A pole of 4 mrad width at 10 m before a wall at 20 m; a beam of 3 mrad straight at the
    /// pole's right edge.
    fn pole_and_wall(pole: u8, wall: u8) -> Scene {
        let mut scene = Scene::new([0.0; 2], 20);
        let solid = |y, width| Shape::cuboid([0.0, y, 0.0], [width, 0.2, 5.0], 0.0);
        scene.add(
            Class::Pole,
            Vec3::zeros(),
            [(solid(10.1, 0.04), Surface::Plain(pole))],
        );
        scene.add(
            Class::Building,
            Vec3::zeros(),
            [(solid(20.1, 30.0), Surface::Plain(wall))],
        );
        scene
    }

    fn at_edge(scene: &Scene, mode: ReturnMode) -> [Option<Return>; 2] {
        let optics = Optics {
            spread_rad: 0.001_5,
            ..Optics::perfect(100.0)
        };
        let view = View::new(scene, EYE, 0.03, 0.0, 0.01);
        let (laser, pose) = (laser(), Pose::upright(EYE));
        let shot = Shot {
            aim: laser.aimed(0.002_1),
            pose: &pose,
            time_s: 0.0,
            guess_m: 20.0,
        };
        shoot(&optics, &view, &shot, mode, &mut Rng::with_seed(0))
    }

    fn classes(returns: [Option<Return>; 2]) -> [Option<Class>; 2] {
        returns.map(|r| r.map(|r| r.hit.class))
    }

    #[test]
    fn dual_reports_last_and_strongest_or_second_strongest() {
        let (pole, wall) = (Some(Class::Pole), Some(Class::Building));
        // One ray of five is on the pole: 0.15 of the light at a quarter of the squared distance,
        // against 0.85.
        assert_eq!(
            classes(at_edge(&pole_and_wall(90, 10), ReturnMode::Dual)),
            [wall, pole],
            "the pole is stronger"
        );
        assert_eq!(
            classes(at_edge(&pole_and_wall(10, 90), ReturnMode::Dual)),
            [wall, pole],
            "second strongest"
        );
        assert_eq!(
            classes(at_edge(&pole_and_wall(90, 10), ReturnMode::Last)),
            [wall, None]
        );
    }

    #[test]
    fn two_surfaces_that_are_too_close_are_one_return_between_them() {
        // A pole whose face is at 10 m, half a metre before a wall.
        let mut scene = Scene::new([0.0; 2], 20);
        let solid = |y, width| Shape::cuboid([0.0, y, 0.0], [width, 0.2, 5.0], 0.0);
        scene.add(
            Class::Pole,
            Vec3::zeros(),
            [(solid(10.1, 0.04), Surface::Plain(50))],
        );
        scene.add(
            Class::Building,
            Vec3::zeros(),
            [(solid(10.6, 30.0), Surface::Plain(50))],
        );
        for mode in [ReturnMode::Strongest, ReturnMode::Last, ReturnMode::Dual] {
            let [one, other] = at_edge(&scene, mode);
            let hit = one.unwrap().hit;
            // One ray of five is on the pole, with 0.15 of the light at (10.5 / 10)^2 of the
            // strength.
            let weight = 0.15 * 10.5_f64.powi(2) / 100.0;
            let expected = (weight * 10.0 + 0.85 * 10.5) / (weight + 0.85);
            assert!(
                (hit.distance_m - expected).abs() < 0.000_1,
                "{mode}: {} {expected}",
                hit.distance_m
            );
            assert_eq!(
                (hit.class, other),
                (Class::Building, one.filter(|_| mode == ReturnMode::Dual))
            );
        }
    }

    #[test]
    fn dual_reports_one_return_twice() {
        let mut scene = Scene::new([0.0; 2], 20);
        let wall = Shape::cuboid([0.0, 20.1, 0.0], [30.0, 0.2, 5.0], 0.0);
        scene.add(Class::Building, Vec3::zeros(), [(wall, Surface::Plain(50))]);
        let [even, odd] = at_edge(&scene, ReturnMode::Dual);
        assert!(even.is_some() && even == odd);
        assert_eq!(
            at_edge(&Scene::new([0.0; 2], 20), ReturnMode::Dual),
            [None, None]
        );
    }

    #[test]
    fn weak_surfaces_are_lost_first() {
        let optics = Optics {
            noise_m: 0.01,
            ..Optics::perfect(100.0)
        };
        let mut rng = Rng::with_seed(1);
        let mut seen = |reflectivity, distance_m| {
            let hit = Hit {
                distance_m,
                object: 2,
                class: Class::Car,
                reflectivity,
                cos_incidence: 1.0,
            };
            let signal = signal(&optics, &hit);
            (0..1000)
                .filter(|_| is_seen(&optics, signal, &mut rng))
                .count()
        };
        assert_eq!(seen(80, 80.0), 1000);
        assert!((400..600).contains(&seen(50, 100.0)));
        assert_eq!(seen(5, 60.0), 0);
        assert_eq!(seen(230, 100.0), 1000, "a traffic sign");
    }

    #[test]
    fn noise_has_the_given_deviation() {
        let optics = Optics {
            noise_m: 0.02,
            ..Optics::perfect(100.0)
        };
        let hit = Hit {
            distance_m: 30.0,
            object: 2,
            class: Class::Car,
            reflectivity: 100,
            cos_incidence: 1.0,
        };
        let one = Return {
            hit,
            signal: 2.0,
            distance_m: 30.0,
        };
        let mut rng = Rng::with_seed(2);
        let errors: Vec<f64> = (0..10_000)
            .map(|_| {
                f64::from(
                    record(&optics, &one, &laser().aimed(0.0), &mut rng)
                        .distance
                        .get(),
                ) * 0.002
                    - 30.0
            })
            .collect();
        let mean = errors.iter().sum::<f64>() / 1e4;
        let deviation = (errors.iter().map(|e| e * e).sum::<f64>() / 1e4).sqrt();
        assert!(
            mean.abs() < 0.001 && (deviation - 0.02).abs() < 0.001,
            "{mean} {deviation}"
        );
        assert!(
            (0..100)
                .all(|_| record(&optics, &one, &laser().aimed(0.0), &mut rng).reflectivity <= 100),
            "diffuse stays diffuse"
        );
    }
}
