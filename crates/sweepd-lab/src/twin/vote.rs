//! The vote: neighbours in a row whose ranges are alike agree on what is ground.

use super::Image;
use super::steps::{self, distance_of};

/// Ranges that differ by less are alike.
const ALIKE: i32 = distance_of(0.5);
/// Neighbours that vote.
const VOTERS: [isize; 6] = [-3, -2, -1, 1, 2, 3];

/// Which pixels are ground, of those that are by the climb.
pub(super) fn vote(image: &Image, climbed: &[bool]) -> Vec<bool> {
    let mut is_ground = climbed.to_vec();
    for (pixel, here) in image.returns.iter().enumerate() {
        let Some(here) = here else { continue };
        let mut votes = 0;
        let mut ayes = 0;
        for right in VOTERS {
            let Some(other) = image.beside(pixel, 0, right) else {
                continue;
            };
            let Some(there) = image.returns[other] else {
                continue;
            };
            if (steps::range(here.range_m) - steps::range(there.range_m)).abs() < ALIKE {
                votes += 1;
                ayes += u32::from(climbed[other]);
            }
        }
        if ayes >= 3 {
            is_ground[pixel] = true;
        } else if ayes <= 1 && votes >= 4 {
            is_ground[pixel] = false;
        }
    }
    is_ground
}
