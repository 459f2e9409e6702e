//! New places of doubted objects. Each object is fitted at its old place and at groups of unexplained points, and one
//! assignment gives each place to one object.

use crate::decide::boxes::MIN_POINTS;
use crate::decide::decision::Decision;
use crate::decide::fit::{Fitter, Score, Thing};
use crate::decide::groups::Group;
use crate::observe::priors::own_bounds;
use crate::observe::view::KNOWN;
use glam::DVec3;
use pathfinding::prelude::{Matrix, kuhn_munkres};
use presight_model::geometry::Pose;
use std::collections::BTreeMap;

/// Maximum distance of a group from the old place of an object that is fitted to it, metres.
const MAX_DISTANCE: f64 = 5.0;
/// A pose that explains an object's points.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    pub pose: Pose,
    pub score: Score,
    /// Log-odds of the views, of the quality of the fit, and of the distance of the move.
    pub odds: f64,
}

impl Decision<'_> {
    /// The new places of doubted objects, by one assignment over all of them: each place takes one object.
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
        // Two groups may be parts of one object. The object with the higher odds keeps the place.
        taken.sort_by(|a, b| b.1.odds.total_cmp(&a.1.odds));
        let ball = |object: u32, place: &Place| Thing::new(self.environment, object).ball(&place.pose);
        let mut kept: BTreeMap<u32, Place> = BTreeMap::new();
        for (object, place) in taken {
            let own = ball(object, &place);
            if !kept.iter().any(|(other, there)| is_same_place(&own, &ball(*other, there))) {
                kept.insert(object, place);
            }
        }
        kept
    }

    /// The poses that explain doubted objects, by row (the object) and column (the group, or the object's old place).
    fn places(&self, doubted: &[u32], groups: &[Group]) -> BTreeMap<(usize, usize), Place> {
        let fitter = self.fitter();
        let standing = self.standing(doubted);
        let mut places = BTreeMap::new();
        for (row, object) in doubted.iter().enumerate() {
            let thing = Thing::new(self.environment, *object);
            let own = self.environment.objects()[*object as usize].world_from_object;
            let place = |start: &Pose| {
                self.place(&fitter, &thing, (&own, start)).filter(|place| {
                    let ball = thing.ball(&place.pose);
                    !standing.iter().any(|other| is_same_place(&ball, other))
                })
            };
            places.extend(place(&own).map(|place| ((row, groups.len() + row), place)));
            if self.is_rod(*object) {
                continue;
            }
            for (column, group) in groups.iter().enumerate() {
                let is_near = group.bounds.size() <= 2.6 * thing.radius + 0.3
                    && group.bounds.center().distance(own.transform_point(thing.middle)) <= MAX_DISTANCE;
                if !is_near || group.points.len() < MIN_POINTS {
                    continue;
                }
                let (start, explained) = fitter.best(&thing, &own, group.bounds.center(), &group.points);
                if explained >= self.known.options.min_agreeing {
                    places.extend(place(&start).map(|place| ((row, column), place)));
                }
            }
        }
        places
    }

    /// True for a post or a rod. Fits accept points within [`KNOWN`] of a surface, so all rods look alike.
    fn is_rod(&self, object: u32) -> bool {
        let size = 2.0 * own_bounds(&self.environment.objects()[object as usize]).half_extent();
        size.to_array().into_iter().filter(|x| *x < 2.0 * KNOWN).count() >= 2
    }

    /// The pose of an object by the points around a start, if the views decide that it stands there.
    fn place(&self, fitter: &Fitter<'_>, thing: &Thing, (own, start): (&Pose, &Pose)) -> Option<Place> {
        let options = &self.known.options;
        let pose = fitter.settle(thing, start);
        let (score, fit) = (fitter.score(thing, &pose), fitter.fit(thing, &pose));
        // The expected error of a cell is not a misfit.
        let misfit = 0.5 * (fit.chi2 - (fit.on + fit.off) as f64).max(0.0);
        let odds = score.l - misfit + fitter.prior(thing, own, &pose);
        let is_decided = self.is_decisive(&score) && fit.share() >= options.min_agreeing && odds >= options.decisive;
        (is_decided && fitter.is_held(thing, &pose)).then_some(Place { pose, score, odds })
    }
}

/// True if two objects, given by the balls around them, cannot both stand there.
pub(crate) fn is_same_place(a: &(DVec3, f64), b: &(DVec3, f64)) -> bool {
    a.0.distance(b.0) < 0.5 * a.1.min(b.1)
}
