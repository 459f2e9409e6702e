//! Evidence on objects and on the cells of their surfaces.

use crate::observe::view::{PixelEvidence, View};
use crate::options::LearnOptions;
use glam::DVec3;
use presight_model::caster::RayHit;
use presight_model::environment::Environment;
use std::collections::{BTreeMap, BTreeSet};

/// Evidence on the presence of one object or one cell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Natural logarithm of the likelihood ratio, with the object to without it.
    pub l: f64,
    /// Views with evidence.
    pub views: u32,
    /// Views that contradict it.
    pub against: u32,
    /// Stamp of the last view that confirms it, seconds.
    pub confirmed: f64,
    /// Sum of the log-odds of the views that contradict it, positive.
    pub less: f64,
}

impl Evidence {
    /// Adds the sum of one view, limited to `max`.
    fn add(&mut self, sum: f64, max: f64, stamp: f64) {
        if sum == 0.0 {
            return;
        }
        let sum = sum.clamp(-max, max);
        self.l += sum;
        self.views += 1;
        if sum < 0.0 {
            self.against += 1;
            self.less -= sum;
        } else {
            self.confirmed = stamp;
        }
    }
}

/// A cell of an object's surface: index of the object, direction of the surface, and place in the object's frame.
pub(crate) type Cell = (u32, u8, [i32; 3]);

/// A class of sensors, and whether its rays meet the surface almost parallel to it.
pub(crate) type Aspect = (u32, String, bool);

/// An object larger than this is also judged by parts, metres.
pub(crate) const MIN_DIVIDED: f64 = 4.0;
/// Maximum cosine of the incidence of a ray that glass reflects.
const GRAZING: f64 = 0.5;
/// Edge of the parts of a large object, metres.
pub(crate) const PART: f64 = 0.5;
/// Maximum number of steps that the growth of an object's odds keeps.
const MAX_GROWTH: usize = 1000;

/// The edge of the cells of an object of this size, metres.
pub(crate) fn cell_size(size: f64) -> f64 {
    if size > MIN_DIVIDED { PART } else { (size / 6.0).clamp(0.05, PART) }
}

/// Side and place of the cell of a surface point with its normal, in the object's frame.
pub(crate) fn cell(p: DVec3, n: DVec3, size: f64) -> (u8, [i32; 3]) {
    let axis = (0..3).max_by(|a, b| n[*a].abs().total_cmp(&n[*b].abs())).unwrap_or(0);
    let side = 2 * axis as u8 + u8::from(n[axis] < 0.0);
    (side, (p / size).floor().to_array().map(|x| x as i32))
}

/// Sums over the pixels of one view.
#[derive(Clone, Debug, Default)]
pub(crate) struct ViewSums {
    objects: BTreeMap<u32, f64>,
    cells: BTreeMap<Cell, f64>,
    /// Sums by object, separate for rays almost parallel to its surface.
    aspects: BTreeMap<(u32, bool), f64>,
}

impl ViewSums {
    /// The sums of a view: +1 for each pixel that confirms an object, -1 for each that sees through it.
    pub fn of(view: &View, hits: &[Option<RayHit>], environment: &Environment) -> Self {
        let mut sums = Self::default();
        for (at, evidence) in view.evidence.iter().enumerate() {
            let Some(hit) = hits[at] else { continue };
            let (object, sign) = match evidence {
                PixelEvidence::Present => (hit.object, 1.0),
                PixelEvidence::SeenThrough => (hit.object, -1.0),
                _ => continue,
            };
            *sums.objects.entry(object).or_default() += sign;
            let ray = view.world_from_image.rotation * view.pixels.rays[at];
            *sums.aspects.entry((object, hit.normal.dot(ray).abs() < GRAZING)).or_default() += sign;
            let o = &environment.objects()[object as usize];
            let inverse = o.world_from_object.inverse();
            let x = view.world_from_image.transform_point(hit.range * view.pixels.rays[at]);
            let (p, n) = (inverse.transform_point(x), inverse.rotation * hit.normal);
            let (side, place) = cell(p, n, cell_size(o.world_bounds().size()));
            *sums.cells.entry((object, side, place)).or_default() += sign;
        }
        sums
    }
}

/// All evidence on objects.
#[derive(Clone, Debug, Default)]
pub(crate) struct Book {
    pub objects: BTreeMap<u32, Evidence>,
    pub cells: BTreeMap<Cell, Evidence>,
    /// Log-odds of each object after each view.
    pub growth: BTreeMap<u32, Vec<f32>>,
    pub aspects: BTreeMap<Aspect, Evidence>,
}

impl Book {
    /// Adds a view of a sensor class.
    pub fn add(&mut self, sums: &ViewSums, (stamp, class): (f64, &str), options: &LearnOptions) {
        let max = options.max_per_view;
        for (object, sum) in &sums.objects {
            let evidence = self.objects.entry(*object).or_default();
            evidence.add(*sum, max, stamp);
            let growth = self.growth.entry(*object).or_default();
            if growth.len() < MAX_GROWTH {
                growth.push(evidence.l as f32);
            }
        }
        for ((object, is_grazing), sum) in &sums.aspects {
            self.aspects.entry((*object, class.to_owned(), *is_grazing)).or_default().add(*sum, max, stamp);
        }
        for (cell, sum) in &sums.cells {
            self.cells.entry(*cell).or_default().add(*sum, max, stamp);
        }
    }

    /// The cells of an object.
    pub fn cells_of(&self, object: u32) -> impl Iterator<Item = (&Cell, &Evidence)> {
        self.cells.range((object, 0, [i32::MIN; 3])..=(object, u8::MAX, [i32::MAX; 3]))
    }

    /// The evidence on an object by class of sensor, and whether rays meet it almost parallel to its surface.
    pub fn aspects_of(&self, object: u32) -> impl Iterator<Item = (&str, bool, &Evidence)> {
        let range = (object, String::new(), false)..(object + 1, String::new(), false);
        self.aspects.range(range).map(|((_, class, is_grazing), e)| (class.as_str(), *is_grazing, e))
    }

    /// Forgets the evidence on objects of these names.
    pub fn forget(&mut self, environment: &Environment, names: &[String]) {
        let is_named = |object: &u32| names.contains(&environment.objects()[*object as usize].name);
        self.objects.retain(|object, _| !is_named(object));
        self.cells.retain(|cell, _| !is_named(&cell.0));
        self.aspects.retain(|aspect, _| !is_named(&aspect.0));
    }

    /// True if other views confirm nearly all of the surface that some views see through.
    fn is_split(&self, object: u32, options: &LearnOptions) -> bool {
        let contradicted = self.cells_of(object).filter(|(_, e)| e.less >= options.max_per_view);
        let (split, all) = contradicted
            .fold((0, 0), |(split, all), (_, e)| (split + usize::from(e.l + e.less >= options.max_per_view), all + 1));
        split as f64 >= options.min_agreeing * f64::from(all).max(1.0)
    }

    /// True if some views decidedly confirm an object and others decidedly contradict it, such as a door.
    pub fn comes_and_goes(&self, object: u32, options: &LearnOptions) -> bool {
        let Some(e) = self.objects.get(&object) else { return false };
        let has_views = e.against >= options.min_views && e.views >= e.against + options.min_views;
        has_views && e.less >= options.decisive && e.l + e.less >= options.decisive && self.is_split(object, options)
    }

    /// The classes of sensors that see through an object, if other sensors see it, or the same sensors at grazing
    /// incidence.
    pub fn see_through(&self, object: u32, options: &LearnOptions) -> BTreeSet<String> {
        let aspects: Vec<_> = self.aspects_of(object).collect();
        let is_split = self.is_split(object, options);
        let is_seen = |by: &str| {
            aspects
                .iter()
                .any(|(class, is_grazing, e)| e.l >= options.decisive && (*class != by || (*is_grazing && is_split)))
        };
        let through = aspects.iter().filter(|(class, is_grazing, e)| {
            !is_grazing && e.l <= -options.decisive && e.against >= options.min_views && is_seen(class)
        });
        through.map(|(class, ..)| (*class).to_owned()).collect()
    }

    /// Numbers of decided cells of an object that are present and that are gone.
    pub fn decided(&self, object: u32, options: &LearnOptions) -> (usize, usize) {
        let bound = options.max_per_view;
        self.cells_of(object).fold((0, 0), |(present, gone), (_, e)| {
            (present + usize::from(e.l >= bound), gone + usize::from(e.l <= -bound))
        })
    }
}
