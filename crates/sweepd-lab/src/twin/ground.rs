//! The climb: which returns of a column are ground, from the ground straight below the sensor
//! outwards. Columns do not look at each other here; in the [`vote`](super::vote) they do.
//!
//! Heights and distances are in [`steps`]. A way in steps is the number of steps that it rises at 1
//! to 5, so the two are compared as they are.

use super::Image;
use super::steps::{self, distance_of, fit, height_of};

/// A face rises higher than this over its foot, and more than its way less this.
const STEP: i32 = height_of(0.05);
/// Steps of a height that are as long as a step of a distance.
const UP: i32 = (steps::HEIGHT / steps::DISTANCE) as i32;
/// What rises less is ground, or goes on level.
const NOISE: i32 = height_of(0.07);
/// So is what rises no more than 1 in this many.
const FLAT: i32 = 40;
/// The lowest part of a face is ground, up to this.
const FOOT: i32 = height_of(0.02);
/// Rise above which a return is an object.
const HIGHEST: i32 = height_of(0.3);
/// What rises more from a foothold as far before as this is not in doubt.
const HIGHEST_FAR: i32 = height_of(0.15);
const FAR: i32 = distance_of(3.0);
/// Rise above which a return of no face can be a step.
const LEAST_STEP: i32 = height_of(0.1);
/// A fall of less is little however steep it is.
const DEEPEST: i32 = height_of(0.3);
/// What waits is less than this nearer to the plumb line than the foothold.
const LEAN: i32 = distance_of(0.05);
/// How far the column goes on level with what waits before that is ground.
const PLATEAU: i32 = distance_of(1.0);
/// How far the top of an object goes.
const TOP: i32 = distance_of(1.5);

/// Which pixels are ground by the climb of their columns, with the sensor this high over the
/// ground, upright or head down, on a robot that climbs so much.
pub(super) fn climb(image: &Image, is_head_down: bool, height_m: f32, climb_m: f32) -> Vec<bool> {
    let mut is_ground = vec![false; image.returns.len()];
    for column in 0..image.columns {
        let mut spots = Vec::new();
        for row in (0..image.rows).rev() {
            let pixel = column * image.rows + row;
            if let Some(found) = image.returns[pixel] {
                spots.push(Spot {
                    pixel,
                    away: steps::away(found.away_m),
                    height: steps::height(found.height_m + height_m),
                });
            }
        }
        if is_head_down {
            spots.reverse();
        }
        let mut climb = Climb::new(height_of(climb_m), &mut is_ground);
        for (here, part) in spots.iter().zip(parts(&spots)) {
            climb.take(*here, part);
        }
        climb.settle(Verdict::Unknown);
    }
    is_ground
}

/// A return of a column.
#[derive(Clone, Copy)]
struct Spot {
    pixel: usize,
    /// Distance from the plumb line.
    away: i32,
    /// Height over the ground below the sensor.
    height: i32,
}

/// The ground straight below the sensor.
const BELOW_SENSOR: Spot = Spot {
    pixel: usize::MAX,
    away: 0,
    height: 0,
};

/// What a return is of a face.
#[derive(Clone, Copy, PartialEq)]
enum Part {
    Nothing,
    /// What the rest is steep over.
    Foot,
    Rest,
}

/// What the returns of a column are of a face: what is steep over its foot, from the foot up to the
/// last that is also high over it.
fn parts(spots: &[Spot]) -> Vec<Part> {
    let mut parts = vec![Part::Nothing; spots.len()];
    let mut foot = BELOW_SENSOR;
    let mut foot_at = None;
    for (at, here) in spots.iter().enumerate() {
        let rise = fit(here.height - foot.height);
        let way = (here.away - foot.away).abs();
        let is_steep = fit(rise + STEP) > fit(UP * way);
        if !is_steep {
            foot = *here;
            foot_at = Some(at);
        } else if rise > STEP {
            parts[foot_at.unwrap_or(0)..=at].fill(Part::Rest);
            // Below the sensor there is no return.
            if let Some(foot_at) = foot_at {
                parts[foot_at] = Part::Foot;
            }
        }
    }
    parts
}

/// The way up a column.
struct Climb<'a> {
    /// Height of a step that the robot climbs.
    climb: i32,
    /// The ground return that the way has come to.
    foothold: Spot,
    /// What the last return was part of.
    stretch: Option<Stretch>,
    /// What waits: pixels, and whether they are in doubt.
    waiting: Vec<(usize, bool)>,
    is_ground: &'a mut [bool],
}

/// Returns that wait, or that are of an object: the next one may be level with them.
#[derive(Clone, Copy)]
struct Stretch {
    /// Whether they wait; else they are of an object.
    waits: bool,
    /// Distance of the first one.
    start: i32,
    /// The last one.
    edge: Spot,
}

/// What a column shows behind what waits.
enum Verdict {
    Ground,
    Object,
    /// Neither: what is in doubt is ground, the rest is not.
    Unknown,
}

impl<'a> Climb<'a> {
    fn new(climb: i32, is_ground: &'a mut [bool]) -> Self {
        Self {
            climb,
            foothold: BELOW_SENSOR,
            stretch: None,
            waiting: Vec::new(),
            is_ground,
        }
    }

    /// Takes the next return up.
    fn take(&mut self, here: Spot, part: Part) {
        let rise = fit(here.height - self.foothold.height);
        if let Some(stretch) = self.stretch
            && (stretch.waits || here.away - stretch.start < TOP)
        {
            let apart = fit((here.height - stretch.edge.height).abs());
            if rise.abs() < apart {
                // The column comes down again.
                let is_short = stretch.edge.away - stretch.start < PLATEAU;
                self.settle(match is_short {
                    true => Verdict::Object,
                    false => Verdict::Unknown,
                });
            } else if part == Part::Nothing && apart < (here.away - stretch.edge.away).max(NOISE) {
                self.go_on_level(stretch, here);
                return;
            }
        }
        self.judge(here, rise, part);
    }

    /// Takes a return that is level with the stretch before it.
    fn go_on_level(&mut self, stretch: Stretch, here: Spot) {
        if stretch.waits && here.away - stretch.start >= PLATEAU {
            self.settle(Verdict::Ground);
            self.is_ground[here.pixel] = true;
            self.foothold = here;
            return;
        }
        if stretch.waits {
            self.waiting.push((here.pixel, false));
        }
        self.stretch = Some(Stretch {
            edge: here,
            ..stretch
        });
    }

    /// Holds a return against the foothold: ground, what waits, or an object.
    fn judge(&mut self, here: Spot, rise: i32, part: Part) {
        let is_face = part != Part::Nothing;
        let way = here.away - self.foothold.away;
        let falls_little = rise > -way.abs().max(DEEPEST);
        let is_far = way >= FAR && self.foothold.away > 0;
        let highest = if is_far { HIGHEST_FAR } else { HIGHEST };
        let steep = (self.climb + self.climb / 2).max(LEAST_STEP);
        let is_step =
            is_face && rise > self.climb || rise > steep && rise > way - way.div_euclid(4);
        let is_walkable = falls_little && !is_face && !is_step;
        let is_gentle = is_walkable && rise < way.min(highest).max(NOISE);
        let is_flat = is_gentle && (rise <= NOISE || rise * FLAT <= way * UP);
        let is_foot = is_face && falls_little && rise <= FOOT;
        let is_low = rise > 0 && rise <= HIGHEST && !is_step && way > -LEAN;
        if is_flat || is_foot {
            self.settle(Verdict::Unknown);
            self.is_ground[here.pixel] = true;
            // Noise lifts no foothold, and a face on lower ground starts from its own foot.
            if is_flat && rise <= way.max(0) || part == Part::Foot && rise < 0 {
                self.foothold = here;
            }
        } else if is_gentle || is_low {
            let start = match self.stretch {
                Some(stretch) if stretch.waits => stretch.start,
                _ => here.away,
            };
            self.waiting.push((here.pixel, is_gentle));
            self.stretch = Some(Stretch {
                waits: true,
                start,
                edge: here,
            });
        } else {
            self.settle(Verdict::Unknown);
            if rise > 0 && (is_face || is_step && rise <= HIGHEST) {
                self.stretch = Some(Stretch {
                    waits: false,
                    start: here.away,
                    edge: here,
                });
            }
        }
    }

    /// Ends the stretch, and settles what waits.
    fn settle(&mut self, verdict: Verdict) {
        for (pixel, in_doubt) in self.waiting.drain(..) {
            self.is_ground[pixel] = match verdict {
                Verdict::Ground => true,
                Verdict::Object => false,
                Verdict::Unknown => in_doubt,
            };
        }
        self.stretch = None;
    }
}
