//! What there is to see: objects made of solids with a surface, on sloping ground, and the ray that finds the nearest.
//!
//! The slope is a shear. A scene is built on level ground and the ray is bent instead: its rise is lessened by what the
//! ground gains under it. Distances along the ray stay true, upright things stay upright, and everything stands on the
//! ground without being told how high that is.

use fastrand::Rng;

use super::shape::{Bounds, Ray, Shape, Vec3};

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
    /// A lorry or a van.
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
    /// Bins, benches, shelters, fences, tables and shelves.
    Furniture,
    /// Whatever a point of a real scan is on: its labels tell.
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
            Self::Unknown => "unknown",
        }
    }
}

/// How a surface answers a laser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// An ordinary one: reflectivity 0-100 as the sensors calibrate it, more where it is retro-reflecting.
    Plain(u8),
    /// A front with rows of windows, set back into the wall; the number is the wall's reflectivity. Where a window
    /// mirrors the beam away, the hit has reflectivity 0.
    Windows(u8),
    /// Leaves: the light gets lost within, once in so many metres.
    Leaves {
        /// Reflectivity of a leaf.
        reflectivity: u8,
        /// Mean way of the light between leaves, metres.
        free_path_m: f64,
    },
}

/// One solid of an object.
#[derive(Clone, Copy, Debug)]
pub struct Part {
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
    /// What the ground gains in height per metre of x and of y.
    pub slope: [f64; 2],
    /// Reflectivity of the road.
    pub road: u8,
    objects: Vec<Object>,
    parts: Vec<Part>,
}

impl Scene {
    /// Bare ground.
    pub fn new(slope: [f64; 2], road: u8) -> Self {
        let ground = Object { class: Class::Ground, velocity: Vec3::zeros() };
        Self { slope, road, objects: vec![ground], parts: Vec::new() }
    }

    /// Puts in an object and gives its number.
    pub fn add(&mut self, class: Class, velocity: Vec3, parts: impl IntoIterator<Item = (Shape, Surface)>) -> u32 {
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
        assert!((1..=self.objects.len() as u32).contains(&object), "there is no object {object}");
        self.parts.extend(parts.into_iter().map(|(shape, surface)| Part { shape, surface, object }));
    }

    /// The objects by number: that with number n is at index n - 1.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// All solids.
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    fn object(&self, number: u32) -> &Object {
        &self.objects[number as usize - 1]
    }

    /// A point of the world in the frame in which the ground is level.
    pub fn levelled(&self, point: Vec3) -> Vec3 {
        Vec3::new(point.x, point.y, point.z - self.slope[0] * point.x - self.slope[1] * point.y)
    }

    /// The ray in the frame in which the ground is level. Its direction is no longer of length 1, so that distances are
    /// still those of the world.
    fn bent(&self, ray: &Ray) -> Ray {
        Ray { origin: self.levelled(ray.origin), direction: self.levelled(ray.direction), ..*ray }
    }

    fn meet_ground(&self, bent: &Ray) -> Option<Hit> {
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

    /// Whether a bent ray comes within so many metres of a solid, and if so, from where on the outline of it may be as
    /// near: a number beyond all distances where it is not. Leaves are nothing but outline.
    fn outline_m(&self, part: &Part, bent: &Ray, rim_m: f64, time_s: f64) -> Option<f64> {
        let ray = Ray { origin: bent.origin - self.object(part.object).velocity * time_s, ..*bent };
        let enter_m = part.shape.grown(rim_m)?.span(&ray)?.enter_m;
        let core = || part.shape.grown(-rim_m).and_then(|core| core.span(&ray));
        let within = match part.surface {
            Surface::Leaves { .. } => false,
            Surface::Plain(_) => core().is_some(),
            Surface::Windows(_) => core().is_some_and(|span| !is_frame(ray.at(span.enter_m), rim_m)),
        };
        Some(if within { f64::INFINITY } else { enter_m })
    }

    /// Where a bent ray meets a solid at a time; leaves and windows answer by chance.
    fn meet(&self, part: &Part, bent: &Ray, time_s: f64, rng: &mut Rng) -> Option<Hit> {
        let object = self.object(part.object);
        let ray = Ray { origin: bent.origin - object.velocity * time_s, ..*bent };
        let span = part.shape.span(&ray)?;
        let (distance_m, reflectivity, cos_incidence) = match part.surface {
            Surface::Plain(reflectivity) => (span.enter_m, reflectivity, span.cos_incidence),
            Surface::Windows(wall) if span.wall && is_window(ray.at(span.enter_m)) => {
                let recess_m = WINDOW_RECESS_M / span.cos_incidence.max(0.2);
                // Glass mirrors most of a slanting beam away, and nothing comes back.
                let mirrored = rng.f64() > 0.75 * span.cos_incidence;
                (span.enter_m + recess_m, if mirrored { 0 } else { wall / 4 }, span.cos_incidence)
            }
            Surface::Windows(wall) => (span.enter_m, wall, span.cos_incidence),
            Surface::Leaves { reflectivity, free_path_m } => {
                // The depth of the first leaf is exponentially distributed; 1 - f64() is never 0.
                let depth_m = -free_path_m * (1.0 - rng.f64()).ln();
                (span.enter_m + depth_m, reflectivity, 0.7)
            }
        };
        let class = object.class;
        (distance_m < span.leave_m).then_some(Hit {
            distance_m,
            object: part.object,
            class,
            reflectivity,
            cos_incidence,
        })
    }
}

/// How far a window lies behind its wall.
const WINDOW_RECESS_M: f64 = 0.18;

/// Whether a place on a front is glass: storeys of 3 m, a window every 2.2 m.
fn is_window(place: Vec3) -> bool {
    // Fronts run along x or y; the sum tells places apart on both.
    let along = (place.x + place.y).rem_euclid(2.2);
    let up = (place.z - 0.4).rem_euclid(3.0);
    place.z > 0.9 && along < 1.2 && (0.6..2.1).contains(&up)
}

/// Whether a place on a front is within so many metres of where glass begins or ends.
fn is_frame(place: Vec3, rim_m: f64) -> bool {
    let is_glass = is_window(place);
    [Vec3::x(), Vec3::z()]
        .into_iter()
        .any(|way| [rim_m, -rim_m].into_iter().any(|off_m| is_window(place + way * off_m) != is_glass))
}

/// Sectors of a turn in the index of a [`View`].
const SECTORS: usize = 720;

/// How far beside a beam a solid is still looked for: more than the beams of any sensor are wide, radians.
const RIM_RAD: f64 = 0.003;

/// One solid as seen from the eye: what a ray must have for a test to be worth while.
#[derive(Clone, Copy)]
struct Candidate {
    part: u32,
    /// Horizontal distance of its nearest place.
    near_m: f64,
    /// Horizontal distance of its farthest place.
    far_m: f64,
    /// Least and greatest rise of a ray that can meet it, metres a metre.
    rise: [f64; 2],
}

/// A scene from one place, over a short time: for each half degree the solids that can be there, nearest first.
pub struct View<'a> {
    scene: &'a Scene,
    sectors: Vec<Vec<Candidate>>,
}

impl<'a> View<'a> {
    /// The view of rays that start within `margin_m` of an eye and within `half_s` seconds of a time.
    pub fn new(scene: &'a Scene, eye: Vec3, margin_m: f64, time_s: f64, half_s: f64) -> Self {
        let mut view = Self { scene, sectors: vec![Vec::new(); SECTORS] };
        let eye = scene.levelled(eye);
        for (part, solid) in (0..).zip(scene.parts()) {
            let velocity = scene.object(solid.object).velocity;
            let mut bounds = solid.shape.bounds().grown(margin_m + velocity.norm() * half_s);
            bounds.centre = [bounds.centre[0] + velocity.x * time_s, bounds.centre[1] + velocity.y * time_s];
            view.enter(part, &bounds, eye);
        }
        for sector in &mut view.sectors {
            sector.sort_by(|a, b| a.near_m.total_cmp(&b.near_m));
        }
        view
    }

    fn enter(&mut self, part: u32, bounds: &Bounds, eye: Vec3) {
        let [near_m, far_m] = bounds.reach(eye);
        let [low, high] = bounds.z.map(|z| z - eye.z);
        if near_m == 0.0 {
            let candidate = Candidate { part, near_m, far_m, rise: [f64::NEG_INFINITY, f64::INFINITY] };
            self.sectors.iter_mut().for_each(|sector| sector.push(candidate));
            return;
        }
        let rise = [low / if low < 0.0 { near_m } else { far_m }, high / if high > 0.0 { near_m } else { far_m }];
        let (centre, edges) = bounds.azimuths(eye);
        let [first, last] =
            [edges[0] - RIM_RAD, edges[1] + RIM_RAD].map(|edge| ((centre + edge) * PER_SECTOR).floor() as i64);
        for sector in first..=last {
            self.sectors[sector.rem_euclid(SECTORS as i64) as usize].push(Candidate { part, near_m, far_m, rise });
        }
    }

    /// The nearest thing that a ray meets within `max_m`. Chance decides about leaves and windows.
    pub fn cast(&self, ray: &Ray, time_s: f64, max_m: f64, rng: &mut Rng) -> Option<Hit> {
        self.look(ray, 0.0, time_s, max_m, rng).hit
    }

    /// The same of the middle of a beam, with whether the whole of it may meet something else: a cone about the ray of
    /// half an angle of `spread_rad`.
    pub fn look(&self, ray: &Ray, spread_rad: f64, time_s: f64, max_m: f64, rng: &mut Rng) -> Look {
        let bent = self.scene.bent(ray);
        let mut hit = self.scene.meet_ground(&bent).filter(|hit| hit.distance_m <= max_m);
        let mut limit_m = hit.map_or(max_m, |hit| hit.distance_m);
        let across = bent.direction.xy().norm();
        let rise = bent.direction.z / across;
        // What a rise of the cone's rim adds, and with it the growth of the solids at their farthest.
        let slack = spread_rad * (1.0 + rise * rise);
        let mut edge_m = f64::INFINITY;
        let sector = (ray.azimuth_rad * PER_SECTOR).floor() as i64;
        for candidate in &self.sectors[sector.rem_euclid(SECTORS as i64) as usize] {
            if candidate.near_m > limit_m * across {
                break;
            }
            if rise < candidate.rise[0] - slack || rise > candidate.rise[1] + slack {
                continue;
            }
            let part = &self.scene.parts[candidate.part as usize];
            if spread_rad > 0.0 {
                let rim_m = spread_rad * (candidate.far_m / across).min(limit_m);
                let Some(met_m) = self.scene.outline_m(part, &bent, rim_m, time_s) else { continue };
                edge_m = edge_m.min(met_m);
            }
            let met = self.scene.meet(part, &bent, time_s, rng);
            if let Some(met) = met.filter(|met| met.distance_m < limit_m) {
                limit_m = met.distance_m;
                hit = Some(met);
            }
        }
        Look { hit, edge: edge_m <= limit_m }
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

/// Sectors a radian.
const PER_SECTOR: f64 = SECTORS as f64 / std::f64::consts::TAU;

#[cfg(test)]
mod tests {
    use super::*;
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
        assert_eq!((hit.object, hit.class, hit.reflectivity), (GROUND, Class::Ground, 20));
        assert_eq!(cast(&scene, &Ray::new(EYE, 1.0, 0.0), 0.0), None);
        assert_eq!(cast(&scene, &Ray::new(EYE, 1.0, -0.01), 0.0), None, "200 m away");
    }

    #[test]
    fn rising_ground_is_met_sooner_and_things_stand_on_it() {
        let mut scene = Scene::new([0.0, 0.05], 20);
        scene.add(Class::Pole, Vec3::zeros(), [(Shape::cylinder([0.0, 20.0, 0.0], 0.5, 1.5), Surface::Plain(30))]);
        // z = 2 - s sin w = 0.05 s cos w
        let (sin, cos) = 0.1_f64.sin_cos();
        let ground = cast(&scene, &Ray::new(EYE, 0.0, -0.1), 0.0).unwrap();
        assert!((ground.distance_m - 2.0 / (sin + 0.05 * cos)).abs() < 1e-12);
        // At y = 20 the ground is 1 m high, the pole's top 2.5 m: a level ray at 2 m meets it, one at 2.6 m does not.
        assert!((cast(&scene, &Ray::new(EYE, 0.0, 0.0), 0.0).unwrap().distance_m - 19.5).abs() < 1e-12);
        let above = Ray::new(EYE + Vec3::z() * 0.6, 0.0, 0.0);
        assert_ne!(cast(&scene, &above, 0.0).map(|hit| hit.class), Some(Class::Pole));
    }

    #[test]
    fn the_nearest_of_many_is_found_as_by_trying_all() {
        let mut rng = Rng::with_seed(7);
        let mut scene = Scene::new([0.01, -0.02], 20);
        for _ in 0..300 {
            let place = [rng.f64() * 80.0 - 40.0, rng.f64() * 80.0 - 40.0, rng.f64()];
            let size = [0.2 + rng.f64() * 2.0, 0.2 + rng.f64() * 4.0, 0.2 + rng.f64() * 4.0];
            let shape = match rng.u8(0..3) {
                0 => Shape::cuboid(place, size, rng.f64() * 7.0),
                1 => Shape::cylinder(place, size[0], size[2]),
                _ => Shape::ellipsoid(place, size),
            };
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
            let all = scene.parts().iter().filter_map(|part| scene.meet(part, &bent, at_s, &mut Rng::with_seed(0)));
            let naive = all
                .chain(scene.meet_ground(&bent))
                .filter(|hit| hit.distance_m < 100.0)
                .min_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
            assert_eq!(view.cast(&ray, at_s, 100.0, &mut Rng::with_seed(0)), naive);
        }
    }

    #[test]
    fn away_from_edges_the_whole_beam_meets_what_its_middle_does() {
        let mut rng = Rng::with_seed(9);
        let mut scene = Scene::new([0.01, -0.02], 20);
        for _ in 0..200 {
            let place = [rng.f64() * 80.0 - 40.0, rng.f64() * 80.0 - 40.0, rng.f64()];
            let size = [0.2 + rng.f64() * 2.0, 0.2 + rng.f64() * 4.0, 0.2 + rng.f64() * 4.0];
            let shape = match rng.u8(0..3) {
                0 => Shape::cuboid(place, size, rng.f64() * 7.0),
                1 => Shape::cylinder(place, size[0], size[2]),
                _ => Shape::ellipsoid(place, size),
            };
            scene.add(Class::Furniture, Vec3::zeros(), [(shape, Surface::Plain(50))]);
        }
        let (view, spread_rad) = (View::new(&scene, EYE, 0.03, 0.0, 0.01), 0.001_5);
        let (mut edges, mut missed) = (0, 0);
        let dice = &mut Rng::with_seed(0);
        for _ in 0..20_000 {
            let (azimuth_rad, elevation_rad) = (rng.f64() * 7.0, (rng.f64() - 0.6) * 0.6);
            let look = view.look(&Ray::new(EYE, azimuth_rad, elevation_rad), spread_rad, 0.0, 60.0, dice);
            let range_m = |hit: Option<Hit>| hit.map_or(60.0, |hit| hit.distance_m);
            let object = |hit: Option<Hit>| hit.map(|hit| hit.object);
            let differs = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)].into_iter().any(|(across, up)| {
                let (across, up) = (0.8 * spread_rad * across, 0.8 * spread_rad * up);
                let hit = view.cast(&Ray::new(EYE, azimuth_rad + across, elevation_rad + up), 0.0, 60.0, dice);
                object(hit) != object(look.hit) && (range_m(hit) - range_m(look.hit)).abs() > 0.3
            });
            // Ground that ends at the greatest range is no edge.
            let horizon = look.hit.is_none_or(|hit| hit.object == GROUND && hit.distance_m > 40.0);
            edges += usize::from(look.edge);
            missed += usize::from(differs && !look.edge && !horizon);
        }
        // Of the foot of a thing the ground before it is no edge: there is no step in range but where it is flat.
        assert!((200..4_000).contains(&edges) && missed * 50 < edges, "{edges} {missed}");
    }

    #[test]
    fn what_moves_is_elsewhere_later() {
        let mut scene = Scene::new([0.0; 2], 20);
        let car = Shape::cuboid([0.0, 10.0, 0.0], [2.0, 4.0, 3.0], 0.0);
        let number = scene.add(Class::Car, Vec3::new(0.0, 5.0, 0.0), [(car, Surface::Plain(50))]);
        let ahead = Ray::new(EYE, 0.0, 0.0);
        assert!((cast(&scene, &ahead, 0.0).unwrap().distance_m - 8.0).abs() < 1e-12);
        let later = cast(&scene, &ahead, 2.0).unwrap();
        assert!((later.distance_m - 18.0).abs() < 1e-12 && later.object == number);
        assert_eq!(cast(&scene, &Ray::new(EYE, PI, 0.0), 2.0), None);
    }

    #[test]
    fn leaves_stop_one_in_e_rays_at_their_free_path() {
        let mut scene = Scene::new([0.0; 2], 20);
        let leaves = Surface::Leaves { reflectivity: 30, free_path_m: 2.0 };
        scene.add(Class::Tree, Vec3::zeros(), [(Shape::ellipsoid([10.0, 0.0, 2.0], [1.0; 3]), leaves)]);
        let view = View::new(&scene, EYE, 0.01, 0.0, 0.01);
        let mut rng = Rng::with_seed(3);
        let through =
            (0..10_000).filter(|_| view.cast(&Ray::new(EYE, FRAC_PI_2, 0.0), 0.0, 100.0, &mut rng).is_none()).count();
        // 2 m of leaves with a free path of 2 m: exp(-1) = 36.8 % get through, standard deviation 48.
        assert!((3_530..3_830).contains(&through), "{through}");
    }

    #[test]
    fn windows_lie_behind_the_wall() {
        let mut scene = Scene::new([0.0; 2], 20);
        let house = Shape::cuboid([0.0, 15.0, 0.0], [40.0, 10.0, 12.0], 0.0);
        scene.add(Class::Building, Vec3::zeros(), [(house, Surface::Windows(40))]);
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
