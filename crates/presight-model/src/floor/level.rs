//! Levels: floors that a robot reaches from one another, and floors of one height.

use super::field::Span;
use crate::union_find::UnionFind;
use std::collections::{BTreeMap, HashMap};

/// Minimum area of a level that a robot is expected on, relative to the largest one. Table tops and landings are
/// smaller.
const LARGE: f64 = 0.25;
/// Minimum area of a level that is listed, relative to the largest one.
const LISTED: f64 = 0.05;
/// Width of the bins in which the most frequent height of a level is found, metres.
const BIN: f64 = 0.01;

/// A level of a scene. Ramps and steps belong to the level that they lead to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Its most frequent height, metres in the world.
    pub height: f64,
    /// Area of its cells with free room above, square metres.
    pub area: f64,
    /// Its lowest height, metres.
    pub lowest: f64,
    /// Its highest height, metres.
    pub highest: f64,
    /// True if most of its surface faces up. Otherwise it is the inside of a shell whose fronts point outward.
    pub faces_up: bool,
    /// True if something stands on it.
    pub is_furnished: bool,
}

/// Connected floors, before floors of one height are one level.
#[derive(Clone, Debug, Default)]
struct Component {
    cells: usize,
    facing_up: usize,
    lowest: f64,
    highest: f64,
    /// Number of cells and sum of heights, by bin.
    bins: HashMap<i64, (usize, f64)>,
    /// The bin of the latest cells with their number and sum of heights. Neighbours mostly share a bin.
    latest: (i64, (usize, f64)),
}

impl Component {
    fn add(&mut self, span: &Span) {
        if self.cells == 0 {
            (self.lowest, self.highest) = (span.low, span.high);
        }
        (self.lowest, self.highest) = (self.lowest.min(span.low), self.highest.max(span.high));
        self.cells += 1;
        self.facing_up += usize::from(span.faces_up);
        let bin = (span.high / BIN).round() as i64;
        if bin != self.latest.0 {
            self.flush();
            self.latest.0 = bin;
        }
        let (count, sum) = &mut self.latest.1;
        (*count, *sum) = (*count + 1, *sum + span.high);
    }

    fn flush(&mut self) {
        let (bin, (count, sum)) = std::mem::take(&mut self.latest);
        if count > 0 {
            let own = self.bins.entry(bin).or_default();
            *own = (own.0 + count, own.1 + sum);
        }
    }

    fn height(&mut self) -> f64 {
        self.flush();
        let most = self.bins.iter().max_by_key(|(bin, (count, _))| (*count, std::cmp::Reverse(**bin)));
        most.map_or(0.0, |(_, (count, sum))| sum / *count as f64)
    }
}

/// All levels by rising height, and the level of each component of spans by the number of its root.
#[derive(Clone, Debug, Default)]
pub(super) struct Levels {
    pub all: Vec<Level>,
    of_root: HashMap<u32, u32>,
}

impl Levels {
    /// Divides connected spans into levels. Components whose heights are at most a step apart are one level.
    pub fn new(spans: &[Span], sets: &mut UnionFind, step: f64, cell_area: f64) -> Self {
        let mut components: BTreeMap<u32, Component> = BTreeMap::new();
        let mut last: Option<(u32, Component)> = None;
        for (k, span) in spans.iter().enumerate().filter(|(_, span)| !span.is_buried) {
            let root = sets.root(k as u32);
            // Neighbours mostly belong to one component.
            if last.as_ref().is_none_or(|(own, _)| *own != root) {
                let next = components.remove(&root).unwrap_or_default();
                if let Some((own, component)) = last.replace((root, next)) {
                    components.insert(own, component);
                }
            }
            if let Some((_, component)) = &mut last {
                component.add(span);
            }
        }
        components.extend(last);
        let mut by_size: Vec<(u32, Component)> = components.into_iter().collect();
        by_size.sort_by_key(|(root, component)| (std::cmp::Reverse(component.cells), *root));
        let (mut levels, mut of_root) = (Vec::<Level>::new(), HashMap::new());
        // Micrometres, so that heights have an order.
        let key = |height: f64| (height * 1e6).round() as i64;
        let mut by_height: BTreeMap<i64, u32> = BTreeMap::new();
        for (root, mut component) in by_size {
            let height = component.height();
            let near = by_height.range(key(height - step)..=key(height + step)).map(|(_, level)| *level).min();
            let area = component.cells as f64 * cell_area;
            let level = near.unwrap_or_else(|| {
                let faces_up = 2 * component.facing_up > component.cells;
                let (lowest, highest) = (component.lowest, component.highest);
                levels.push(Level { height, area: 0.0, lowest, highest, faces_up, is_furnished: false });
                by_height.insert(key(height), levels.len() as u32 - 1);
                levels.len() as u32 - 1
            });
            let own = &mut levels[level as usize];
            own.area += area;
            (own.lowest, own.highest) = (own.lowest.min(component.lowest), own.highest.max(component.highest));
            of_root.insert(root, level);
        }
        // Numbers by rising height.
        let mut order: Vec<u32> = (0..levels.len() as u32).collect();
        order.sort_by(|a, b| levels[*a as usize].height.total_cmp(&levels[*b as usize].height));
        let mut rank = vec![0; levels.len()];
        order.iter().enumerate().for_each(|(new, old)| rank[*old as usize] = new as u32);
        of_root.values_mut().for_each(|level| *level = rank[*level as usize]);
        let mut all: Vec<Level> = order.iter().map(|old| levels[*old as usize]).collect();
        for span in spans.iter().filter(|span| span.is_buried) {
            let first = all.partition_point(|level| level.height < span.low - step);
            let near = all[first..].iter_mut().take_while(|level| level.height <= span.high + step);
            near.for_each(|level| level.is_furnished = true);
        }
        Self { all, of_root }
    }

    /// The level of a component.
    pub fn of(&self, root: u32) -> Option<usize> {
        self.of_root.get(&root).map(|level| *level as usize)
    }

    fn at_least(&self, share: f64) -> impl Iterator<Item = (usize, &Level)> {
        let largest = self.all.iter().map(|level| level.area).fold(0.0, f64::max);
        self.all.iter().enumerate().filter(move |(_, level)| level.area >= share * largest)
    }

    /// The numbers of the levels that are not much smaller than the largest one, from the lowest to the highest.
    pub fn listed(&self) -> Vec<usize> {
        self.at_least(LISTED).map(|(level, _)| level).collect()
    }

    /// The lowest large level that faces up; the lowest of all if none does. The inside of a shell whose fronts point
    /// outward also looks like a solid: it is the level if nothing stands on the shell.
    pub fn usual(&self) -> Option<usize> {
        let lowest = |up: bool| self.at_least(LARGE).find(|(_, level)| level.faces_up == up);
        match (lowest(true), lowest(false)) {
            (Some(up), Some(down)) if down.1.height < up.1.height && !up.1.is_furnished => Some(down.0),
            (up, down) => up.or(down).map(|(level, _)| level),
        }
    }
}
