//! A scene: objects made of solids with a surface, on sloping ground, and their intersections with
//! rays.
//!
//! The slope is a shear. A scene is built on level ground and the ray is sheared instead: its rise
//! is reduced by the rise of the ground below it. Distances along the ray stay true, upright
//! objects stay upright, and objects stand on the ground without knowing its height.

use fastrand::Rng;

use super::shape::{Brim, Ray, Shape, Span, Vec3, floor};

/// Object number of the ground. Objects count from here; 0 is nothing.
pub const GROUND: u32 = 1;

/// What an object is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Class {
    /// Road, kerbs, pavements, a floor.
    Ground,
    /// A house, or the walls, pillars and ceiling of one.
    Building,
    /// A passenger car.
    Car,
    /// A lorry, a van or a forklift.
    Lorry,
    /// Someone on foot.
    Person,
    /// Someone on a bicycle.
    Cyclist,
    /// A lamp post or a bollard.
    Pole,
    /// A traffic sign with its post.
    Sign,
    /// A tree, a bush or a hedge.
    Tree,
    /// Bins, benches, shelters, fences, tables, shelves, racks and boxes.
    Furniture,
    /// A pallet with what lies on it.
    Pallet,
    /// The surface of a real scan's point, whose class is in the labels.
    Unknown,
}

impl Class {
    /// The word for it in output.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ground => "ground",
            Self::Building => "building",
            Self::Car => "car",
            Self::Lorry => "lorry",
            Self::Person => "person",
            Self::Cyclist => "cyclist",
            Self::Pole => "pole",
            Self::Sign => "sign",
            Self::Tree => "tree",
            Self::Furniture => "furniture",
            Self::Pallet => "pallet",
            Self::Unknown => "unknown",
        }
    }
}

/// How a surface answers a laser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// An ordinary one: reflectivity 0-100 as the sensors calibrate it, more where it is
    /// retro-reflecting.
    Plain(u8),
    /// A front with rows of windows, set back into the wall; the number is the wall's reflectivity.
    /// Where a window mirrors the beam away, the hit has reflectivity 0.
    Windows(u8),
    /// Leaves: the light hits one after a random distance.
    Leaves {
        /// Reflectivity of a leaf.
        reflectivity: u8,
        /// Mean way of the light between leaves, metres.
        free_path_m: f64,
    },
}

/// One solid of an object.
#[derive(Clone, Copy, Debug)]
pub struct Solid {
    /// Its shape, at time 0.
    pub shape: Shape,
    /// Its surface.
    pub surface: Surface,
    object: u32,
}

/// What the parts of an object have in common.
#[derive(Clone, Copy, Debug)]
pub struct Object {
    /// What it is.
    pub class: Class,
    /// How it moves, metres a second.
    pub velocity: Vec3,
}

/// What a ray met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Along the ray, metres.
    pub distance_m: f64,
    /// Object number, [`GROUND`] and up.
    pub object: u32,
    /// What that object is.
    pub class: Class,
    /// Reflectivity, 0-100 diffuse, above that retro-reflecting.
    pub reflectivity: u8,
    /// Cosine of the angle between the ray and the surface's normal.
    pub cos_incidence: f64,
}

/// Objects on a plane.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Rise of the ground per metre of x and of y.
    pub slope: [f64; 2],
    /// Reflectivity of the road.
    pub road: u8,
    objects: Vec<Object>,
    solids: Vec<Solid>,
}

impl Scene {
    /// Bare ground.
    pub fn new(slope: [f64; 2], road: u8) -> Self {
        let ground = Object {
            class: Class::Ground,
            velocity: Vec3::zeros(),
        };
        Self {
            slope,
            road,
            objects: vec![ground],
            solids: Vec::new(),
        }
    }

    /// Puts in an object and gives its number.
    pub fn add(
        &mut self,
        class: Class,
        velocity: Vec3,
        parts: impl IntoIterator<Item = (Shape, Surface)>,
    ) -> u32 {
        self.objects.push(Object { class, velocity });
        let object = self.objects.len() as u32;
        self.extend(object, parts);
        object
    }

    /// Gives an object more parts.
    ///
    /// # Panics
    /// When there is no such object.
    pub fn extend(&mut self, object: u32, parts: impl IntoIterator<Item = (Shape, Surface)>) {
        assert!(
            (1..=self.objects.len() as u32).contains(&object),
            "there is no object {object}"
        );
        self.solids
            .extend(parts.into_iter().map(|(shape, surface)| Solid {
                shape,
                surface,
                object,
            }));
    }

    /// The objects by number: that with number n is at index n - 1.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// All solids.
    pub fn solids(&self) -> &[Solid] {
        &self.solids
    }

    #[inline]
    fn object(&self, number: u32) -> &Object {
        &self.objects[number as usize - 1]
    }

    /// How a solid moves, metres a second.
    #[inline]
    pub(super) fn velocity(&self, solid: &Solid) -> Vec3 {
        self.object(solid.object).velocity
    }

    /// A point of the world in the frame in which the ground is level.
    pub fn levelled(&self, point: Vec3) -> Vec3 {
        Vec3::new(
            point.x,
            point.y,
            point.z - self.slope[0] * point.x - self.slope[1] * point.y,
        )
    }

    /// What a sensor at a point would be in or over at time 0, if the ground below it is not free.
    pub(super) fn below(&self, point: Vec3) -> Option<Class> {
        let eye = self.levelled(point);
        let is_below = |solid: &&Solid| {
            let bounds = solid.shape.bounds();
            bounds.reach(eye)[0] < HOUSING_M && bounds.z[0] < eye.z + HOUSING_M
        };
        let solid = self.solids.iter().find(is_below)?;
        Some(self.object(solid.object).class)
    }

    /// The ray in the frame in which the ground is level. Its direction is no longer of length 1,
    /// so that distances are still those of the world.
    #[inline]
    pub(super) fn bent(&self, ray: &Ray) -> Ray {
        Ray {
            origin: self.levelled(ray.origin),
            direction: self.levelled(ray.direction),
            ..*ray
        }
    }

    #[inline]
    pub(super) fn meet_ground(&self, bent: &Ray) -> Option<Hit> {
        let distance_m = -bent.origin.z / bent.direction.z;
        let cos_incidence = -bent.direction.z;
        (cos_incidence > 0.0).then_some(Hit {
            distance_m,
            object: GROUND,
            class: Class::Ground,
            reflectivity: self.road,
            cos_incidence,
        })
    }

    /// A bent ray as a solid meets it that moves with its object: where it stood at time 0.
    #[inline]
    pub(super) fn beside(&self, solid: &Solid, bent: &Ray, time_s: f64) -> Ray {
        Ray {
            origin: bent.origin - self.velocity(solid) * time_s,
            ..*bent
        }
    }

    /// The hit of a ray that passes through a solid; random for leaves and windows.
    #[inline]
    pub(super) fn meet(&self, solid: &Solid, ray: &Ray, span: &Span, rng: &mut Rng) -> Option<Hit> {
        let (distance_m, reflectivity, cos_incidence) = match solid.surface {
            Surface::Plain(reflectivity) => (span.enter_m, reflectivity, span.cos_incidence),
            Surface::Windows(wall) if span.wall && is_window(ray.at(span.enter_m)) => {
                let recess_m = WINDOW_RECESS_M / span.cos_incidence.max(0.2);
                // Glass mirrors most of a slanting beam away, and nothing comes back.
                let mirrored = rng.f64() > 0.75 * span.cos_incidence;
                (
                    span.enter_m + recess_m,
                    if mirrored { 0 } else { wall / 4 },
                    span.cos_incidence,
                )
            }
            Surface::Windows(wall) => (span.enter_m, wall, span.cos_incidence),
            Surface::Leaves {
                reflectivity,
                free_path_m,
            } => {
                // The depth of the first leaf is exponentially distributed; 1 - f64() is never 0.
                let depth_m = -free_path_m * (1.0 - rng.f64()).ln();
                (span.enter_m + depth_m, reflectivity, 0.7)
            }
        };
        (distance_m < span.leave_m).then(|| Hit {
            distance_m,
            object: solid.object,
            class: self.object(solid.object).class,
            reflectivity,
            cos_incidence,
        })
    }
}

impl Solid {
    /// Distance from which on the outline of the solid may be within the rim of a ray; greater than
    /// all distances if it is not. Leaves are all outline.
    #[inline]
    pub(super) fn outline_m(&self, brim: &Brim, ray: &Ray, rim_m: f64) -> f64 {
        let within = match (self.surface, brim.core_m) {
            (Surface::Leaves { .. }, _) | (_, None) => false,
            (Surface::Plain(_), Some(_)) => true,
            (Surface::Windows(_), Some(core_m)) => !is_frame(ray.at(core_m), rim_m),
        };
        if within { f64::INFINITY } else { brim.outer_m }
    }
}

/// How far a sensor's housing reaches from its origin, metres.
const HOUSING_M: f64 = 0.05;

/// How far a window lies behind its wall.
pub(super) const WINDOW_RECESS_M: f64 = 0.18;

/// Whether a place on a front is glass: storeys of 3 m, a window every 2.2 m.
fn is_window(place: Vec3) -> bool {
    is_storey(place.z) && is_column(place.x + place.y)
}

/// Whether windows are at a height.
fn is_storey(z_m: f64) -> bool {
    z_m > 0.9 && (0.6..2.1).contains(&remainder(z_m - 0.4, 3.0))
}

/// Whether there are windows at this coordinate along a front. Fronts run along x or y; the sum of
/// both serves for either.
fn is_column(along_m: f64) -> bool {
    remainder(along_m, 2.2) < 1.2
}

/// The remainder of a division by the period, except for the last bits: a tenth of the time of
/// `f64::rem_euclid`.
fn remainder(place_m: f64, period_m: f64) -> f64 {
    place_m - period_m * floor(place_m / period_m)
}

/// Whether a place on a front is within this many metres of where glass begins or ends.
fn is_frame(place: Vec3, rim_m: f64) -> bool {
    let along_m = place.x + place.y;
    let up_m = place.z;
    is_storey(up_m) && changes_near(is_column, along_m, rim_m)
        || is_column(along_m) && changes_near(is_storey, up_m, rim_m)
}

/// Whether the value changes within this many metres to either side.
fn changes_near(is_there: fn(f64) -> bool, at_m: f64, rim_m: f64) -> bool {
    let here = is_there(at_m);
    is_there(at_m + rim_m) != here || is_there(at_m - rim_m) != here
}
