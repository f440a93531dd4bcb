//! Ground truth of a scan, and the objects derived from it.

use super::ScoreError;
use super::classes::{UNLABELLED, class_of, is_ground};
use super::linkage::{link, number_groups};

/// Points of one label nearer than this are one object, metres.
const LINK_M: f64 = 1.0;
/// Points that an object has.
const OBJECT_POINTS: std::ops::RangeInclusive<u32> = 10..=300_000;
/// No object.
pub(super) const NO_OBJECT: u32 = 0;

/// True labels of a scan, and its objects.
///
/// Objects are the units of USE and OSE: points of one true label (class and instance) that are
/// linked if nearer than 1 m, 10 to 300,000 of them. Ground and points without a class are not
/// objects. A wall interrupted by a gap is two objects.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    labels: Vec<u32>,
    objects: Vec<u32>,
}

impl Truth {
    /// Of points (x, y, z in metres, and a remission that does not matter) and their true labels.
    ///
    /// # Errors
    /// [`ScoreError::Truth`].
    pub fn new(points: &[[f32; 4]], labels: Vec<u32>) -> Result<Self, ScoreError> {
        if labels.len() != points.len() {
            return Err(ScoreError::Truth {
                points: points.len(),
                labels: labels.len(),
            });
        }
        let objects = objects(points, &labels);
        Ok(Self { labels, objects })
    }

    /// True label of every point: class in the low 16 bits, instance in the high.
    pub fn labels(&self) -> &[u32] {
        &self.labels
    }

    /// Object of every point, from 1; 0 for none.
    pub fn objects(&self) -> &[u32] {
        &self.objects
    }
}

fn objects(points: &[[f32; 4]], labels: &[u32]) -> Vec<u32> {
    let mut chosen: Vec<u32> = (0..labels.len() as u32)
        .filter(|&point| {
            let class = class_of(labels[point as usize]);
            !is_ground(class) && class != UNLABELLED
        })
        .collect();
    chosen.sort_by_key(|&point| labels[point as usize]);
    let mut objects = vec![NO_OBJECT; labels.len()];
    let mut last = NO_OBJECT;
    for same in chosen.chunk_by(|&a, &b| labels[a as usize] == labels[b as usize]) {
        let places: Vec<[f32; 3]> = same
            .iter()
            .map(|&point| place(points[point as usize]))
            .collect();
        let groups = link(&places, LINK_M);
        let numbers = number_groups(&groups, OBJECT_POINTS, NO_OBJECT, &mut last);
        for (&point, &group) in same.iter().zip(&groups) {
            objects[point as usize] = numbers[group as usize];
        }
    }
    objects
}

/// Where a point is.
pub(super) fn place(point: [f32; 4]) -> [f32; 3] {
    let [x, y, z, _] = point;
    [x, y, z]
}
