//! Evidence on objects and on their parts after several views.

use crate::learn::LearnOptions;
use crate::view::{Says, View};
use glam::DVec3;
use presight_model::caster::RayHit;
use presight_model::environment::Environment;
use std::collections::{BTreeMap, BTreeSet};

/// Evidence on one object or one cell: logarithm of the odds that it stands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evidence {
    /// Natural logarithm of the likelihood ratio: with the object against without it.
    pub l: f64,
    /// Views that said something.
    pub views: u32,
    /// Views that spoke against it.
    pub against: u32,
    /// Stamp of the last view that spoke for it, seconds.
    pub confirmed: f64,
    /// What these views said, counted positive.
    pub less: f64,
}

impl Evidence {
    /// Adds the sum of one view, which counts at most `most`.
    fn add(&mut self, sum: f64, most: f64, stamp: f64) {
        if sum == 0.0 {
            return;
        }
        let sum = sum.clamp(-most, most);
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

/// A cell of an object's surface: the object, the direction of the surface and the place in its frame.
pub(crate) type Cell = (u32, u8, [i32; 3]);

/// What one view says of objects and cells: sums over pixels.
#[derive(Clone, Debug, Default)]
pub(crate) struct Delta {
    pub objects: BTreeMap<u32, f64>,
    pub cells: BTreeMap<Cell, f64>,
    pub pixels: BTreeMap<u32, Pixels>,
    /// Sums of objects, apart for rays that meet them flat.
    pub aspects: BTreeMap<(u32, bool), f64>,
}

/// What the pixels say whose ray meets an object first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pixels {
    /// It is there.
    pub there: usize,
    /// The ray passed through it.
    pub through: usize,
    /// Something else stands before it.
    pub before: usize,
    /// The same would be measured without it.
    pub same: usize,
    /// The ray went on, near an edge or flat along its surface.
    pub edge: usize,
}

/// An object larger than this is judged by parts, too, metres.
pub(crate) const BIG: f64 = 4.0;
/// A ray that meets a surface at a smaller cosine meets it flat: glass reflects it.
const FLAT: f64 = 0.5;
/// The edge of the parts of a big object, metres.
pub(crate) const PART: f64 = 0.5;

/// The edge of the cells of an object of some size, metres.
pub(crate) fn cell_size(size: f64) -> f64 {
    if size > BIG { PART } else { (size / 6.0).clamp(0.05, PART) }
}

impl Delta {
    /// The sums of a view: +1 for each pixel that sees an object, -1 for each that sees through it.
    pub fn of(view: &View, met: &[Option<RayHit>], environment: &Environment) -> Self {
        let mut delta = Self::default();
        for (at, says) in view.says.iter().enumerate() {
            let Some(met) = met[at] else { continue };
            let object = met.object;
            let pixels = delta.pixels.entry(object).or_default();
            let (count, sign) = match says {
                Says::There => (&mut pixels.there, 1.0),
                Says::Through => (&mut pixels.through, -1.0),
                Says::Before => (&mut pixels.before, 0.0),
                Says::Same => (&mut pixels.same, 0.0),
                Says::Edge => (&mut pixels.edge, 0.0),
                Says::Nothing => continue,
            };
            *count += 1;
            if sign == 0.0 {
                continue;
            }
            *delta.objects.entry(object).or_default() += sign;
            let ray = view.world_from_image.rotation * view.kept.rays[at];
            *delta.aspects.entry((object, met.normal.dot(ray).abs() < FLAT)).or_default() += sign;
            let o = &environment.objects()[object as usize];
            let inverse = o.world_from_object.inverse();
            let x = view.world_from_image.transform_point(met.range * view.kept.rays[at]);
            let (p, n) = (inverse.transform_point(x), inverse.rotation * met.normal);
            let (side, place) = cell(p, n, cell_size(o.world_bounds().size()));
            *delta.cells.entry((object, side, place)).or_default() += sign;
        }
        delta
    }
}

/// The side and the place of the cell of a point of a surface with its normal, in the object's frame.
pub(crate) fn cell(p: DVec3, n: DVec3, size: f64) -> (u8, [i32; 3]) {
    let axis = (0..3).max_by(|a, b| n[*a].abs().total_cmp(&n[*b].abs())).unwrap_or(0);
    let side = 2 * axis as u8 + u8::from(n[axis] < 0.0);
    (side, (p / size).floor().to_array().map(|x| x as i32))
}

/// All evidence on objects.
#[derive(Clone, Debug, Default)]
pub(crate) struct Book {
    pub objects: BTreeMap<u32, Evidence>,
    pub cells: BTreeMap<Cell, Evidence>,
    /// How the odds of objects that something speaks against grew, view by view.
    pub growth: BTreeMap<u32, Vec<f32>>,
    /// Pixels of each object.
    pub pixels: BTreeMap<u32, Pixels>,
    /// Evidence on objects by class of sensor, apart for rays that meet them flat.
    pub aspects: BTreeMap<(u32, String, bool), Evidence>,
}

/// Most steps of growth that are kept.
const STEPS: usize = 1000;

impl Book {
    pub fn add(&mut self, delta: &Delta, (stamp, class): (f64, &str), options: &LearnOptions) {
        let most = options.most_per_view;
        for (object, sum) in &delta.objects {
            let evidence = self.objects.entry(*object).or_default();
            evidence.add(*sum, most, stamp);
            let growth = self.growth.entry(*object).or_default();
            if growth.len() < STEPS {
                growth.push(evidence.l as f32);
            }
        }
        for (object, more) in &delta.pixels {
            let sum = self.pixels.entry(*object).or_default();
            sum.there += more.there;
            sum.through += more.through;
            sum.before += more.before;
            sum.same += more.same;
            sum.edge += more.edge;
        }
        for ((object, flat), sum) in &delta.aspects {
            self.aspects.entry((*object, class.to_owned(), *flat)).or_default().add(*sum, most, stamp);
        }
        for (cell, sum) in &delta.cells {
            self.cells.entry(*cell).or_default().add(*sum, most, stamp);
        }
    }

    /// The cells of an object.
    pub fn cells_of(&self, object: u32) -> impl Iterator<Item = (&Cell, &Evidence)> {
        self.cells.range((object, 0, [i32::MIN; 3])..=(object, u8::MAX, [i32::MAX; 3]))
    }

    /// True if nearly all of an object's surface that some views see through is seen by others.
    fn is_split(&self, object: u32, options: &LearnOptions) -> bool {
        let less = self.cells_of(object).filter(|(_, e)| e.less >= options.most_per_view);
        let (split, all) = less
            .fold((0, 0), |(split, all), (_, e)| (split + usize::from(e.l + e.less >= options.most_per_view), all + 1));
        split as f64 >= options.least_agreeing * f64::from(all).max(1.0)
    }

    /// True if views are sure that an object stands and others that it does not: it comes and goes, as a door does.
    pub fn comes_and_goes(&self, object: u32, options: &LearnOptions) -> bool {
        let Some(e) = self.objects.get(&object) else { return false };
        let views = e.against >= options.least_views && e.views >= e.against + options.least_views;
        views && e.less >= options.sure && e.l + e.less >= options.sure && self.is_split(object, options)
    }

    /// The classes of sensors that see through an object which others see, or which they see themselves where rays meet it flat.
    pub fn see_through(&self, object: u32, options: &LearnOptions) -> BTreeSet<String> {
        let range = (object, String::new(), false)..(object + 1, String::new(), false);
        let aspects: Vec<_> = self.aspects.range(range).map(|((_, class, flat), e)| (class, *flat, e)).collect();
        let is_split = self.is_split(object, options);
        let is_seen = |by: &String| {
            let sees = |(class, flat, e): &&(&String, bool, &Evidence)| {
                e.l >= options.sure && (*class != by || (*flat && is_split))
            };
            aspects.iter().any(|aspect| sees(&aspect))
        };
        let through = aspects.iter().filter(|(class, flat, e)| {
            !flat && e.l <= -options.sure && e.against >= options.least_views && is_seen(class)
        });
        through.map(|(class, _, _)| (*class).clone()).collect()
    }

    /// How many decided cells of an object stand, and how many are gone.
    pub fn decided(&self, object: u32, options: &LearnOptions) -> (usize, usize) {
        let least = options.most_per_view;
        self.cells_of(object).fold((0, 0), |(stand, gone), (_, e)| {
            (stand + usize::from(e.l >= least), gone + usize::from(e.l <= -least))
        })
    }
}
