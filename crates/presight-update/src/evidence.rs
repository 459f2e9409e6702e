//! Evidence on objects and on their parts after several views.

use crate::caster::Met;
use crate::learn::LearnOptions;
use crate::view::{Says, View};
use glam::DVec3;
use presight_model::environment::{Environment, Object};
use std::collections::BTreeMap;

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
}

impl Evidence {
    /// Adds the sum of one view, which counts at most `most`.
    fn add(&mut self, sum: f64, most: f64, stamp: f64) {
        if sum == 0.0 {
            return;
        }
        self.l += sum.clamp(-most, most);
        self.views += 1;
        if sum < 0.0 {
            self.against += 1;
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
/// The edge of the parts of a big object, metres.
pub(crate) const PART: f64 = 0.5;

/// The edge of an object's cells, metres.
pub(crate) fn cell_size(object: &Object) -> f64 {
    let size = object.world_bounds().size();
    if size > BIG { PART } else { (size / 6.0).clamp(0.05, PART) }
}

impl Delta {
    /// The sums of a view: +1 for each pixel that sees an object, -1 for each that sees through it.
    pub fn of(view: &View, met: &[Option<Met>], environment: &Environment) -> Self {
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
            let o = &environment.objects()[object as usize];
            let inverse = o.world_from_object.inverse();
            let x = view.world_from_image.transform_point(met.range * view.kept.rays[at]);
            let (p, n) = (inverse.transform_point(x), inverse.rotation * met.normal);
            *delta.cells.entry(cell(object, p, n, cell_size(o))).or_default() += sign;
        }
        delta
    }
}

fn cell(object: u32, p: DVec3, n: DVec3, size: f64) -> Cell {
    let axis = (0..3).max_by(|a, b| n[*a].abs().total_cmp(&n[*b].abs())).unwrap_or(0);
    let side = 2 * axis as u8 + u8::from(n[axis] < 0.0);
    (object, side, (p / size).floor().to_array().map(|x| x as i32))
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
}

/// Most steps of growth that are kept.
const STEPS: usize = 1000;

impl Book {
    pub fn add(&mut self, delta: &Delta, stamp: f64, options: &LearnOptions) {
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
        for (cell, sum) in &delta.cells {
            self.cells.entry(*cell).or_default().add(*sum, most, stamp);
        }
    }

    /// The cells of an object.
    pub fn cells_of(&self, object: u32) -> impl Iterator<Item = (&Cell, &Evidence)> {
        self.cells.range((object, 0, [i32::MIN; 3])..=(object, u8::MAX, [i32::MAX; 3]))
    }

    /// How many decided cells of an object stand, and how many are gone.
    pub fn decided(&self, object: u32, options: &LearnOptions) -> (usize, usize) {
        let least = options.most_per_view;
        self.cells_of(object).fold((0, 0), |(stand, gone), (_, e)| {
            (stand + usize::from(e.l >= least), gone + usize::from(e.l <= -least))
        })
    }
}
