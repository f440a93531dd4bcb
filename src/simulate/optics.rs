//! From what a beam meets to what the receiver reports: spread of the beam, several returns, weak ones, noise.

use fastrand::Rng;

use super::scene::{Class, Hit, View};
use super::shape::{Ray, Vec3};
use crate::wire::data::{Record, ReturnMode};

/// What the lasers and the receiver can do.
#[derive(Clone, Copy, Debug)]
pub struct Optics {
    /// Nearer than this nothing is reported, metres.
    pub min_range_m: f64,
    /// A surface of reflectivity 50 is seen half of the time from here, metres; nothing is reported beyond.
    pub max_range_m: f64,
    /// Standard deviation of the range, metres.
    pub noise_m: f64,
    /// Share of the shots that give nothing for no visible reason.
    pub dropout: f64,
    /// Half the angle of the cone that a beam lights, radians.
    pub spread_rad: f64,
}

impl Optics {
    /// An instrument without flaws: every hit within range is reported, where it is.
    pub fn perfect(max_range_m: f64) -> Self {
        Self { min_range_m: 0.0, max_range_m, noise_m: 0.0, dropout: 0.0, spread_rad: 0.0 }
    }

    /// Whether the instrument has no flaws and need not roll dice.
    fn is_perfect(&self) -> bool {
        self.dropout == 0.0 && self.noise_m == 0.0
    }
}

/// One return: what was met, and how much light came back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Return {
    /// The place that sent most of the light.
    pub hit: Hit,
    /// Light of all of it; 1 is what the receiver sees half of the time.
    pub signal: f64,
}

/// A shot of one beam: where it starts and points, and when.
#[derive(Clone, Copy, Debug)]
pub struct Shot {
    /// Where the light leaves.
    pub origin: Vec3,
    /// Azimuth in the scene, radians.
    pub azimuth_rad: f64,
    /// Elevation, radians.
    pub elevation_rad: f64,
    /// When, seconds after the start.
    pub time_s: f64,
}

/// The rays of a beam: across and up in units of its spread, and the share of its light.
const FOOTPRINT: [(f64, f64, f64); 5] =
    [(0.0, 0.0, 0.4), (0.8, 0.0, 0.15), (-0.8, 0.0, 0.15), (0.0, 0.8, 0.15), (0.0, -0.8, 0.15)];

/// Pulses nearer to each other than this are one return, metres.
const RESOLUTION_M: f64 = 0.8;

/// The returns that a shot gives, one for each block that reports it: `[only]` or, in dual mode, `[even, odd]`.
///
/// Dual (VLP-16 User Manual, section 6.2): even = last, odd = strongest, or second strongest when the strongest is
/// the last.
pub fn shoot(optics: &Optics, view: &View<'_>, shot: &Shot, mode: ReturnMode, rng: &mut Rng) -> [Option<Return>; 2] {
    if mode == ReturnMode::Strongest {
        // The middle of the beam stands for all of it: a fifth of the work.
        let hit = cast(optics, view, shot, FOOTPRINT[0], rng);
        let only = hit.map(|hit| Return { hit, signal: signal(optics, &hit) });
        return [only.filter(|only| is_seen(optics, only, rng)), None];
    }
    let mut returns = separate(optics, view, shot, rng);
    returns.retain(|one| is_seen(optics, one, rng));
    let last = returns.last().copied();
    returns.sort_by(|a, b| b.signal.total_cmp(&a.signal));
    match mode {
        ReturnMode::Dual if returns.first().copied() == last => [last, returns.get(1).copied().or(last)],
        ReturnMode::Dual => [last, returns.first().copied()],
        _ => [last, None],
    }
}

fn cast(optics: &Optics, view: &View<'_>, shot: &Shot, ray: (f64, f64, f64), rng: &mut Rng) -> Option<Hit> {
    let (across, up) = (ray.0 * optics.spread_rad, ray.1 * optics.spread_rad);
    let ray = Ray::new(shot.origin, shot.azimuth_rad + across, shot.elevation_rad + up);
    view.cast(&ray, shot.time_s, optics.max_range_m, rng).filter(|hit| hit.distance_m >= optics.min_range_m)
}

/// The returns of the whole beam, nearest first: what its rays meet, gathered where it lies too close to tell apart.
fn separate(optics: &Optics, view: &View<'_>, shot: &Shot, rng: &mut Rng) -> Vec<Return> {
    let mut met: Vec<Return> = Vec::with_capacity(FOOTPRINT.len());
    for ray in FOOTPRINT {
        if let Some(hit) = cast(optics, view, shot, ray, rng) {
            met.push(Return { hit, signal: ray.2 * signal(optics, &hit) });
        }
    }
    met.sort_by(|a, b| a.hit.distance_m.total_cmp(&b.hit.distance_m));
    let mut returns: Vec<Return> = Vec::with_capacity(met.len());
    let (mut brightest, mut reached_m) = (0.0, f64::NEG_INFINITY);
    for one in met {
        let ground = one.hit.class == Class::Ground && returns.last().is_some_and(|r| r.hit.class == Class::Ground);
        match returns.last_mut() {
            // Ground under a flat beam gives one long pulse.
            Some(whole) if one.hit.distance_m - reached_m < RESOLUTION_M || ground => {
                whole.signal += one.signal;
                if one.signal > brightest {
                    (brightest, whole.hit) = (one.signal, one.hit);
                }
            }
            _ => {
                brightest = one.signal;
                returns.push(one);
            }
        }
        reached_m = one.hit.distance_m;
    }
    returns
}

/// Light that comes back from a whole beam on this surface, by distance, reflectivity and incidence.
fn signal(optics: &Optics, hit: &Hit) -> f64 {
    let diffuse = f64::from(hit.reflectivity.min(100)) / 50.0;
    let retro = 1.0 + f64::from(hit.reflectivity.saturating_sub(100)) / 10.0;
    // Real surfaces are rough: even a grazing beam meets facets that face it.
    let facing = 0.3 + 0.7 * hit.cos_incidence;
    diffuse * retro * facing * (optics.max_range_m / hit.distance_m).powi(2)
}

fn is_seen(optics: &Optics, one: &Return, rng: &mut Rng) -> bool {
    // From 0.6 to 1.4 of the signal that is seen half of the time.
    optics.is_perfect() || (rng.f64() >= optics.dropout && rng.f64() < (one.signal - 0.6) / 0.8)
}

/// The three bytes that report a return, with the noise of range and reflectivity.
pub fn record(optics: &Optics, hit: &Hit, distance_unit_m: f64, rng: &mut Rng) -> Record {
    let range_m = hit.distance_m + optics.noise_m * gaussian(rng);
    // A return is reported even where the noise pushes it below the first unit.
    let units = (range_m / distance_unit_m).round().clamp(1.0, f64::from(u16::MAX));
    let blur = if optics.is_perfect() { 0 } else { rng.i16(-2..=2) };
    let (low, high) = if hit.reflectivity > 100 { (101, 255) } else { (0, 100) };
    let reflectivity = (i16::from(hit.reflectivity) + blur).clamp(low, high);
    Record { distance: (units as u16).into(), reflectivity: reflectivity as u8 }
}

/// A normally distributed number (Box and Muller).
fn gaussian(rng: &mut Rng) -> f64 {
    let radius = (-2.0 * (1.0 - rng.f64()).ln()).sqrt();
    radius * (std::f64::consts::TAU * rng.f64()).cos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::scene::{Scene, Surface};
    use crate::simulate::shape::Shape;

    const EYE: Vec3 = Vec3::new(0.0, 0.0, 2.0);

    /// A pole of 4 mrad width at 10 m before a wall at 20 m; a beam of 3 mrad straight at the pole's right edge.
    fn pole_and_wall(pole: u8, wall: u8) -> Scene {
        let mut scene = Scene::new([0.0; 2], 20);
        let solid = |y, width| Shape::cuboid([0.0, y, 0.0], [width, 0.2, 5.0], 0.0);
        scene.add(Class::Pole, Vec3::zeros(), [(solid(10.1, 0.04), Surface::Plain(pole))]);
        scene.add(Class::Building, Vec3::zeros(), [(solid(20.1, 30.0), Surface::Plain(wall))]);
        scene
    }

    fn at_edge(scene: &Scene, mode: ReturnMode) -> [Option<Return>; 2] {
        let optics = Optics { spread_rad: 0.001_5, ..Optics::perfect(100.0) };
        let view = View::new(scene, EYE, 0.03, 0.0, 0.01);
        let shot = Shot { origin: EYE, azimuth_rad: 0.002_1, elevation_rad: 0.0, time_s: 0.0 };
        shoot(&optics, &view, &shot, mode, &mut Rng::with_seed(0))
    }

    fn classes(returns: [Option<Return>; 2]) -> [Option<Class>; 2] {
        returns.map(|r| r.map(|r| r.hit.class))
    }

    #[test]
    fn dual_reports_last_and_strongest_or_second_strongest() {
        let (pole, wall) = (Some(Class::Pole), Some(Class::Building));
        // One ray of five is on the pole: 0.15 of the light at a quarter of the squared distance, against 0.85.
        assert_eq!(classes(at_edge(&pole_and_wall(90, 10), ReturnMode::Dual)), [wall, pole], "the pole is stronger");
        assert_eq!(classes(at_edge(&pole_and_wall(10, 90), ReturnMode::Dual)), [wall, pole], "second strongest");
        assert_eq!(classes(at_edge(&pole_and_wall(90, 10), ReturnMode::Last)), [wall, None]);
    }

    #[test]
    fn dual_reports_one_return_twice() {
        let mut scene = Scene::new([0.0; 2], 20);
        let wall = Shape::cuboid([0.0, 20.1, 0.0], [30.0, 0.2, 5.0], 0.0);
        scene.add(Class::Building, Vec3::zeros(), [(wall, Surface::Plain(50))]);
        let [even, odd] = at_edge(&scene, ReturnMode::Dual);
        assert!(even.is_some() && even == odd);
        assert_eq!(at_edge(&Scene::new([0.0; 2], 20), ReturnMode::Dual), [None, None]);
    }

    #[test]
    fn weak_surfaces_are_lost_first() {
        let optics = Optics { noise_m: 0.01, ..Optics::perfect(100.0) };
        let mut rng = Rng::with_seed(1);
        let mut seen = |reflectivity, distance_m| {
            let hit = Hit { distance_m, object: 2, class: Class::Car, reflectivity, cos_incidence: 1.0 };
            let one = Return { hit, signal: signal(&optics, &hit) };
            (0..1000).filter(|_| is_seen(&optics, &one, &mut rng)).count()
        };
        assert_eq!(seen(80, 80.0), 1000);
        assert!((400..600).contains(&seen(50, 100.0)));
        assert_eq!(seen(5, 60.0), 0);
        assert_eq!(seen(230, 100.0), 1000, "a traffic sign");
    }

    #[test]
    fn noise_has_the_given_deviation() {
        let optics = Optics { noise_m: 0.02, ..Optics::perfect(100.0) };
        let hit = Hit { distance_m: 30.0, object: 2, class: Class::Car, reflectivity: 100, cos_incidence: 1.0 };
        let mut rng = Rng::with_seed(2);
        let errors: Vec<f64> = (0..10_000)
            .map(|_| f64::from(record(&optics, &hit, 0.002, &mut rng).distance.get()) * 0.002 - 30.0)
            .collect();
        let mean = errors.iter().sum::<f64>() / 1e4;
        let deviation = (errors.iter().map(|e| e * e).sum::<f64>() / 1e4).sqrt();
        assert!(mean.abs() < 0.001 && (deviation - 0.02).abs() < 0.001, "{mean} {deviation}");
        assert!((0..100).all(|_| record(&optics, &hit, 0.002, &mut rng).reflectivity <= 100), "diffuse stays diffuse");
    }
}
