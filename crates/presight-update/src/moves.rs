//! Where doubted objects stand now: each is fitted where it stood and at groups of unexplained points, and one assignment gives
//! each place to one object.

use crate::decide::{Decision, Group, LEAST_NEW};
use crate::evidence::BIG;
use crate::fit::{Fitter, Score, Thing};
use glam::DVec3;
use pathfinding::prelude::{Matrix, kuhn_munkres};
use presight_model::geometry::Pose;
use std::collections::BTreeMap;

/// A group may be so far from the object that is fitted to it, metres.
const FARTHEST: f64 = 5.0;
/// Points within half of this count as on a surface, metres: things that are thinner across than this in two directions look the same.
const THINNEST: f64 = 0.1;
/// The share of a group's points that an object explains which stands there.
const LEAST_EXPLAINED: f64 = 0.8;

/// A pose that explains what an object became.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    pub pose: Pose,
    pub score: Score,
    /// Logarithm of its odds: what views say, how well it fits, and how far things are moved.
    pub odds: f64,
}

impl Decision<'_> {
    pub(crate) fn fitter(&self) -> Fitter<'_> {
        let (views, most_per_view) = (self.views.iter().collect(), self.options.most_per_view);
        Fitter { caster: self.caster, views, most_per_view }
    }

    pub(crate) fn is_sure(&self, score: &Score) -> bool {
        score.l >= self.options.sure
            && score.views >= self.options.least_views
            && score.share() >= self.options.least_agreeing
            && score.worst > -self.options.sure
    }

    /// Where doubted objects stand now, by one assignment over all of them: one place takes one object.
    pub(crate) fn moves(&self, doubted: &[u32], groups: &[Group]) -> BTreeMap<u32, Place> {
        if doubted.is_empty() {
            return BTreeMap::new();
        }
        let places = self.places(doubted, groups);
        let weight = |(row, column)| places.get(&(row, column)).map_or(0, |p: &Place| (100.0 * p.odds) as i64);
        let columns = groups.len() + doubted.len();
        let (_, assigned) = kuhn_munkres(&Matrix::from_fn(doubted.len(), columns, weight));
        let mut taken: Vec<(u32, Place)> = assigned
            .into_iter()
            .enumerate()
            .filter_map(|(row, column)| Some((doubted[row], *places.get(&(row, column))?)))
            .collect();
        // Two groups may be parts of one thing: the surer object keeps the place.
        taken.sort_by(|a, b| b.1.odds.total_cmp(&a.1.odds));
        let mut kept: BTreeMap<u32, Place> = BTreeMap::new();
        for (object, place) in taken {
            let spot = self.spot(object, &place.pose);
            if !kept.iter().any(|(other, there)| is_same_spot(&spot, &self.spot(*other, &there.pose))) {
                kept.insert(object, place);
            }
        }
        kept
    }

    /// The poses that explain doubted objects, by row (which object) and column (which group, or its own place).
    fn places(&self, doubted: &[u32], groups: &[Group]) -> BTreeMap<(usize, usize), Place> {
        let fitter = self.fitter();
        let standing = self.standing(doubted);
        let mut places = BTreeMap::new();
        for (row, object) in doubted.iter().enumerate() {
            let thing = Thing::new(self.environment, *object);
            let own = self.environment.objects()[*object as usize].world_from_object;
            let middle = own.transform_point(thing.middle);
            let place = |start: &Pose| {
                self.place(&fitter, &thing, (&own, start)).filter(|place| {
                    let spot = self.spot(*object, &place.pose);
                    !standing.iter().any(|other| is_same_spot(&spot, other))
                })
            };
            places.extend(place(&own).map(|place| ((row, groups.len() + row), place)));
            if self.is_rod(*object) {
                continue;
            }
            for (column, group) in groups.iter().enumerate() {
                let fits = group.bounds.size() <= 2.6 * thing.radius + 0.3
                    && group.bounds.center().distance(middle) <= FARTHEST;
                if !fits || group.points.len() < LEAST_NEW.1 {
                    continue;
                }
                let (start, explained) = fitter.best(&thing, &own, group.bounds.center(), &group.points);
                if explained >= LEAST_EXPLAINED {
                    places.extend(place(&start).map(|place| ((row, column), place)));
                }
            }
        }
        places
    }

    /// True for a post or a rod: elsewhere it looks like any other one.
    fn is_rod(&self, object: u32) -> bool {
        let o = &self.environment.objects()[object as usize];
        let size = 2.0 * o.mesh.bounds().transformed(&o.object_from_mesh).half_extent();
        size.to_array().into_iter().filter(|x| *x < THINNEST).count() >= 2
    }

    /// Where an object stands by the points around a start, if the views are sure of it.
    fn place(&self, fitter: &Fitter<'_>, thing: &Thing, (own, start): (&Pose, &Pose)) -> Option<Place> {
        let pose = fitter.settle(thing, start);
        let (score, fit) = (fitter.score(thing, &pose), fitter.fit(thing, &pose));
        // The expected error of a cell does not count as a misfit.
        let misfit = 0.5 * (fit.chi2 - (fit.on + fit.off) as f64).max(0.0);
        let odds = score.l - misfit + fitter.prior(thing, own, &pose);
        let is_sure = self.is_sure(&score) && fit.share() >= self.options.least_agreeing && odds >= self.options.sure;
        (is_sure && fitter.is_held(thing, &pose)).then_some(Place { pose, score, odds })
    }

    /// The places of small objects that stand where the model has them: nothing else stands there.
    pub(crate) fn standing(&self, doubted: &[u32]) -> Vec<(DVec3, f64)> {
        let stands = |object: &u32| {
            let sure = self.book.objects.get(object).is_some_and(|e| e.l >= self.options.sure);
            sure && !doubted.contains(object)
        };
        let spot = |object: u32| self.spot(object, &self.environment.objects()[object as usize].world_from_object);
        self.live().filter(stands).map(spot).filter(|(_, radius)| 2.0 * radius <= BIG).collect()
    }

    /// The middle of an object at a pose and half of its diagonal, metres.
    fn spot(&self, object: u32, pose: &Pose) -> (DVec3, f64) {
        let thing = Thing::new(self.environment, object);
        (pose.transform_point(thing.middle), thing.radius)
    }
}

/// True if two things, by middle and half of the diagonal, cannot stand there both.
pub(crate) fn is_same_spot(a: &(DVec3, f64), b: &(DVec3, f64)) -> bool {
    a.0.distance(b.0) < 0.5 * a.1.min(b.1)
}
