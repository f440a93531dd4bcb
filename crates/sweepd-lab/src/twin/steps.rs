//! Whole steps: what distances and heights are rounded to before they are compared.

/// Steps of a distance in a metre: 7.8 mm each.
pub(super) const DISTANCE: f32 = 128.0;
/// Steps of a height in a metre: 1.6 mm each. A way of 1 to 5 rises one of them in each step of
/// distance.
pub(super) const HEIGHT: f32 = 5.0 * DISTANCE;

/// Numbers of steps have 16 bits: what does not fit becomes the nearest that does.
pub(super) fn fit(steps: i32) -> i32 {
    steps.clamp(i16::MIN.into(), i16::MAX.into())
}

/// A range: to the nearest step, at least one.
pub(super) fn range(range_m: f32) -> i32 {
    fit((range_m * DISTANCE).round() as i32).max(1)
}

/// A distance from the plumb line: rounded down.
pub(super) fn away(away_m: f32) -> i32 {
    fit((away_m * DISTANCE) as i32)
}

/// A height: to the nearest step, and from half way to the even one.
pub(super) fn height(height_m: f32) -> i32 {
    fit((height_m * HEIGHT).round_ties_even() as i32)
}

/// A number of the ground's rule that is a distance in metres: to the nearest step.
pub(super) const fn distance_of(metres: f32) -> i32 {
    (metres * DISTANCE + 0.5) as i32
}

/// A number of the ground's rule that is a height in metres: to the nearest step.
pub(super) const fn height_of(metres: f32) -> i32 {
    (metres * HEIGHT + 0.5) as i32
}
