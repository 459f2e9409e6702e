//! A site that is no longer as its model has it, and a drive through it. The frames come from the test kit's own
//! caster.

use glam::{DQuat, DVec3};
use presight_model::environment::{Environment, NewObject, Object};
use presight_model::geometry::{Aabb, Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::measured::Frame;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_testkit::Random;
use presight_testkit::caster::Caster;
use presight_testkit::changes::is_furniture;
use presight_testkit::oracle::Oracle;
use presight_testkit::route::{Driving, Route};
use std::collections::{BTreeMap, BTreeSet};

/// How much is changed.
#[derive(Clone, Copy, Debug)]
pub struct Amounts {
    pub removed: usize,
    pub moved: usize,
    pub added: usize,
    pub walkers: usize,
    /// Views, 0.5 m apart.
    pub views: usize,
}

/// How far off the poses are, and are said to be: metres and degrees.
#[derive(Clone, Copy, Debug)]
pub struct Off {
    pub is: (f64, f64),
    pub stated: (f64, f64),
}

/// Names of the objects that are removed and added.
pub type Changed = (BTreeSet<String>, BTreeSet<String>);

/// A model, the site, and what differs.
pub struct Case {
    pub map: World,
    pub site: World,
    pub removed: BTreeSet<String>,
    pub moved: BTreeMap<String, Pose>,
    pub added: BTreeSet<String>,
    pub route: Route,
    seed: u64,
    amounts: Amounts,
}

fn route_of(map: &Environment, views: usize, seed: u64) -> Route {
    let bounds = map.bounds();
    let oracle = Oracle::new(map, bounds.center()).expect("something to see");
    let driving = Driving { seconds: 0.5 * views as f64 / SPEED, speed: SPEED, turn: 0.7 };
    Route::wander(&oracle, &bounds, &driving, seed)
}

/// Metres per second: two views a second are 0.5 m apart.
const SPEED: f64 = 1.0;

fn middle(o: &Object) -> DVec3 {
    o.world_bounds().center()
}

/// The bounds of an object at another pose.
fn bounds_at(object: &Object, pose: &Pose) -> Aabb {
    object.mesh.bounds().transformed(&(pose.to_affine() * object.object_from_mesh))
}

/// True if a box touches no other object, except for buildings.
fn is_free(site: &Environment, name: &str, bounds: &Aabb) -> bool {
    let slack = DVec3::splat(0.02);
    site.objects().iter().filter(|o| !o.is_deleted() && o.name != name).all(|o| {
        let b = o.world_bounds();
        let size = b.max - b.min;
        let flat = size.x.max(size.y) > 4.5;
        flat || (b.max.cmplt(bounds.min + slack) | b.min.cmpgt(bounds.max - slack)).any()
    })
}

/// True if a box stays off the route.
fn is_clear(bounds: &Aabb, route: &Route) -> bool {
    let (half, c) = (bounds.half_extent(), bounds.center());
    route.places().all(|[x, y]| (c.x - x).abs() > half.x + 0.4 || (c.y - y).abs() > half.y + 0.4)
}

impl Case {
    /// Changes a model. The same seed gives the same site and drive.
    pub fn new(map: Environment, amounts: Amounts, seed: u64) -> Self {
        let route = route_of(&map, amounts.views, seed);
        let mut random = Random(seed ^ 0x7570_6461_7465);
        let mut names: Vec<String> = map.objects().iter().filter(|o| is_furniture(o)).map(|o| o.name.clone()).collect();
        (1..names.len()).rev().for_each(|k| names.swap(k, random.below(k + 1)));
        let mut site = map.clone();
        let removed: BTreeSet<String> = names.iter().take(amounts.removed).cloned().collect();
        for name in &removed {
            site.delete(name).expect("the object exists");
        }
        let mut moved = BTreeMap::new();
        for name in names.iter().skip(amounts.removed).take(amounts.moved) {
            let object = map.object(name).expect("the object exists");
            for _ in 0..40 {
                let turn = DQuat::from_rotation_z(random.uniform(-30f64, 30.0).to_radians());
                let (far, azimuth) = (random.uniform(0.1, 1.5), random.uniform(0.0, std::f64::consts::TAU));
                let to = middle(object) + far * DVec3::new(azimuth.cos(), azimuth.sin(), 0.0);
                let pose = object.world_from_object;
                let pose = Pose {
                    translation: to + turn * (pose.translation - middle(object)),
                    rotation: (turn * pose.rotation).normalize(),
                };
                let there = bounds_at(object, &pose);
                if is_free(&site, name, &there) && is_clear(&there, &route) {
                    site.set_pose(name, pose).expect("a sound pose");
                    moved.insert(name.clone(), pose);
                    break;
                }
            }
        }
        let mut added = BTreeSet::new();
        let places: Vec<[f64; 2]> = route.places().collect();
        for k in 0..40 * amounts.added {
            if added.len() == amounts.added {
                break;
            }
            let object = map.object(&names[k % names.len()]).expect("the object exists");
            let [x, y] = places[random.below(places.len())];
            let (aside, azimuth) = (random.uniform(1.0, 4.0), random.uniform(0.0, std::f64::consts::TAU));
            let to = DVec3::new(x + aside * azimuth.cos(), y + aside * azimuth.sin(), middle(object).z);
            let pose = object.world_from_object;
            let pose = Pose { translation: pose.translation + to - middle(object), ..pose };
            let there = bounds_at(object, &pose);
            let small = there.size() > 0.25 && there.min.z < 0.3;
            if small && is_free(&site, "", &there) && is_clear(&there, &route) {
                let name = format!("added {}", added.len());
                let new = NewObject {
                    object_from_mesh: object.object_from_mesh,
                    ..NewObject::new(&name, pose, object.mesh.clone())
                };
                site.insert(new).expect("room for another object");
                added.insert(name);
            }
        }
        Self { map: World::new(map), site: World::new(site), removed, moved, added, route, seed, amounts }
    }

    /// Two states of a site, with the objects that one of them lacks.
    #[allow(dead_code, reason = "for one of those who use this file")]
    pub fn of(map: World, site: World, (removed, added): Changed, amounts: Amounts, seed: u64) -> Self {
        let route = route_of(site.environment(), amounts.views, seed);
        Self { map, site, removed, moved: BTreeMap::new(), added, route, seed, amounts }
    }

    /// The same site on another route.
    #[allow(dead_code, reason = "for one of those who use this file")]
    pub fn on_another_way(&self, seed: u64, views: usize) -> Self {
        Self {
            map: self.map.clone(),
            site: self.site.clone(),
            removed: self.removed.clone(),
            moved: self.moved.clone(),
            added: self.added.clone(),
            route: route_of(self.site.environment(), views, seed),
            seed,
            amounts: Amounts { views, ..self.amounts },
        }
    }

    /// The frames of a sensor with poses that are off, and with the true ones.
    pub fn drive(&self, sensor: &Sensor, off: Off) -> Vec<(Frame, PoseEstimate, Pose)> {
        let mut caster = Caster::new(self.site.environment(), sensor.clone(), self.seed).with_walkers(
            self.amounts.walkers,
            &self.route,
            self.seed,
        );
        let mut random = Random(self.seed ^ 0x706f_7365);
        let route = self.route.clone();
        let (metres, degrees) = off.stated;
        let rad = degrees.to_radians();
        let covariance = PoseCovariance::from_sigmas([metres, metres, metres, rad, rad, rad]);
        let mut frames = Vec::new();
        for k in 0..self.amounts.views {
            let time = 0.5 * k as f64;
            if time > route.duration() {
                break;
            }
            let frame = caster.frame(&|t| route.at(t), time, None);
            let truth = route.at(time);
            let error: [f64; 6] =
                std::array::from_fn(|i| random.normal(if i < 3 { off.is.0 } else { off.is.1.to_radians() }));
            let estimate =
                PoseEstimate::new(RobotPose::new(presight_localize::motion::moved(&truth, &error)), covariance);
            frames.push((frame, estimate, truth));
        }
        frames
    }
}
