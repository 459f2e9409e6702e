//! One worker: decides which samples of a feature are seen.

use super::area::Span;
use super::polygon::Faces;
use super::tally::{SampleState, Tally, share};
use super::tiles::Tiles;
use super::undecided::{Line, UndecidedSample, hide_along};
use super::{Visibility, VisibilityContext};
use crate::environment::{Appearance, FeatureShape};
use crate::features::sample::{Piece, Sample};
use crate::features::{FeatureStats, Hidden, HiddenInterval, PlacedFeature, Reason, SeenFeature};
use crate::geometry::plane_of_polygon;
use crate::index::{QueryResult, Region};
use glam::{DMat3, DVec2, DVec3};
use std::ops::Range;

/// How many ids are kept in mind while pixels are looked through.
const LATEST: usize = 4;

/// What is known of a feature beside its geometry.
pub(super) struct FeatureSurface<'a> {
    slots: &'a [u32],
    /// Normals of what it lies on, as far as that can be seen, image frame.
    normals: Vec<DVec3>,
    /// A landmark is seen from here only.
    front: Option<DVec3>,
    /// Applies to all of it.
    reason: Option<Reason>,
    /// How far its points may be off by rounding, metres.
    rounding: f64,
}

impl FeatureSurface<'_> {
    /// Only what is in between decides.
    pub fn is_plain(&self) -> bool {
        self.reason.is_none() && self.front.is_none()
    }

    /// How far its points may be off by rounding, metres.
    pub fn rounding(&self) -> f64 {
        self.rounding
    }

    /// Leaves open from where it is seen flat.
    pub fn forget_normals(&mut self) {
        self.normals.clear();
    }

    /// True of polygons that it lies on.
    pub fn holds(&self, slot: u32) -> bool {
        self.slots.contains(&slot)
    }

    /// Of the surfaces it lies on, the one seen most directly.
    pub fn cosine(&self, ray: DVec3) -> Option<f64> {
        self.normals.iter().map(|n| n.dot(ray).abs().min(1.0)).reduce(f64::max)
    }
}

pub(super) struct FeatureResult {
    /// `None` if nothing is seen, and only what is seen is asked for.
    pub seen: Option<SeenFeature>,
    pub stats: FeatureStats,
    pub pixels: Vec<u32>,
}

/// One worker with its memory.
pub(super) struct Worker<'a> {
    pub(super) frame: &'a VisibilityContext<'a>,
    pub(super) faces: Faces,
    pub(super) tiles: Tiles,
    pieces: Vec<Piece>,
    states: Vec<SampleState>,
    pub(super) open: Vec<UndecidedSample>,
    /// Pixels of a patch.
    pub(super) spans: Vec<Span>,
    /// Polygons of the image that may hide what is asked for, by number in `faces`.
    pub(super) near: Vec<u32>,
    /// Slots of what hides the samples of a straight segment.
    pub(super) by: Vec<u32>,
    center: Option<(i64, i64)>,
    /// Ids that were taken last, the latest first.
    latest: [u32; LATEST],
    /// Number of the feature, or of the pixel, that asks.
    asking: u32,
    found: QueryResult,
    pub(super) stats: FeatureStats,
}

impl<'a> Worker<'a> {
    pub fn new(frame: &'a VisibilityContext<'a>) -> Self {
        Self {
            frame,
            faces: Faces::new(frame),
            tiles: Tiles::new(frame.sampler.pixel_angle()),
            pieces: Vec::new(),
            states: Vec::new(),
            open: Vec::new(),
            spans: Vec::new(),
            near: Vec::new(),
            by: Vec::new(),
            center: None,
            latest: [0; LATEST],
            asking: 0,
            found: QueryResult::default(),
            stats: FeatureStats::default(),
        }
    }

    /// The samples that only what is in between decides.
    pub fn query_samples(&mut self, placed: &PlacedFeature) -> super::QuerySamples {
        if placed.feature.shape.is_contour() {
            return Vec::new();
        }
        let (own, points) = self.prepare(placed);
        if placed.feature.shape.is_area() && self.decides_area(&points) {
            return Vec::new();
        }
        self.sample(&placed.feature.shape, &own, &points);
        let width = i64::from(self.frame.images.width);
        let number = |i: usize| {
            let (column, row) = self.nearest_pixel(self.pixel_of(i));
            (row * width + column) as u32
        };
        self.open.iter().enumerate().map(|(i, o)| (o.at, number(i))).collect()
    }

    /// What is seen of a feature; `told` are slots that may hide the samples left open, in order, in place of the images.
    pub fn feature(&mut self, placed: &PlacedFeature, told: Option<&[Option<u32>]>) -> FeatureResult {
        let frame = self.frame;
        let shape = &placed.feature.shape;
        let (own, points) = self.prepare(placed);
        let mut tally = self.tally(placed, &own, &points, told);
        let (visible, mut hidden) = if shape.is_area() { tally.shares(frame) } else { (tally.visible, tally.hidden) };
        self.stats.asked = 1;
        match frame.options.hidden {
            Hidden::Count if visible.is_empty() => {
                return FeatureResult { seen: None, stats: self.stats, pixels: Vec::new() };
            }
            Hidden::Reason if visible.is_empty() => {
                let last = hidden.iter().map(|h| h.reason).max();
                hidden = last.map(|reason| HiddenInterval { t: [0.0, 1.0], reason, by: None }).into_iter().collect();
            }
            _ => {}
        }
        let world_from_object = placed.object.map(|o| frame.environment.objects()[o as usize].world_from_object);
        let in_world = |p: &DVec3| world_from_object.map_or(*p, |pose| pose.transform_point(*p));
        let seen = SeenFeature {
            points_world: shape.points().iter().map(in_world).collect(),
            normal_world: placed
                .feature
                .properties
                .normal
                .and_then(|n| world_from_object.map_or(n, |pose| pose.rotation * n).try_normalize()),
            visible_fraction: share(tally.seen, tally.inside),
            visible,
            hidden,
            range: tally.nearest.map(|(_, at)| at.length()),
            cos_incidence: tally.nearest.and_then(|(_, at)| own.cosine(at / at.length())),
            existence: placed.feature.existence.at(frame.time),
            feature: placed.feature.clone(),
            branch: None,
            roi: None,
            roi_flag: None,
            image_covariance: None,
        };
        FeatureResult { seen: Some(seen), stats: self.stats, pixels: tally.pixels }
    }

    /// What is seen of the samples of a feature that is no contour.
    pub(super) fn tally(
        &mut self,
        placed: &PlacedFeature,
        own: &FeatureSurface<'_>,
        points: &[DVec3],
        told: Option<&[Option<u32>]>,
    ) -> Tally {
        let shape = &placed.feature.shape;
        let whole = match shape {
            FeatureShape::Segment { .. } => self.straight([points[0], points[1]], own, told),
            shape if shape.is_area() => self.area(points, own),
            _ => None,
        };
        whole.unwrap_or_else(|| {
            self.stats = FeatureStats { features: 1, ..FeatureStats::default() };
            self.sample(shape, own, points);
            self.decide(own, shape, points, told);
            self.close();
            let mut tally = Tally::default();
            for (piece, state) in self.pieces.iter().zip(&self.states) {
                tally.take(self.frame, piece, *state);
            }
            tally
        })
    }

    /// What is known of a feature, and its points in the image frame.
    pub(super) fn prepare<'p>(&mut self, placed: &'p PlacedFeature) -> (FeatureSurface<'p>, Vec<DVec3>) {
        let (points, image_from_object, rounding) = self.frame.in_image(placed);
        self.stats = FeatureStats { features: 1, ..FeatureStats::default() };
        (self.own(placed, &points, image_from_object, rounding), points)
    }

    /// Samples a feature: `open` are those left open.
    fn sample(&mut self, shape: &FeatureShape, own: &FeatureSurface<'_>, points: &[DVec3]) {
        let sampler = &self.frame.sampler;
        self.pieces.clear();
        let mut take = |piece: Piece| self.pieces.push(piece);
        match shape {
            FeatureShape::Point { .. } | FeatureShape::Reflector { .. } | FeatureShape::Contour { .. } => {
                take(sampler.point(points[0]));
            }
            FeatureShape::Segment { .. } => sampler.segment(points[0], points[1], &mut take),
            FeatureShape::Patch { .. } | FeatureShape::Fiducial { .. } => match self.frame.options.visibility {
                Visibility::Image => sampler.small_patch(points, &mut take),
                Visibility::Rays => sampler.patch(points, &mut take),
            },
        }
        self.open(own, points);
    }

    /// What holds for all of a feature.
    fn own<'p>(
        &mut self,
        placed: &'p PlacedFeature,
        points: &[DVec3],
        image_from_object: DMat3,
        rounding: f64,
    ) -> FeatureSurface<'p> {
        let frame = self.frame;
        let class = &frame.sensor.spec().class;
        let (mut normals, mut there, mut away) = (Vec::new(), 0, 0);
        for slot in &placed.slots {
            let Some((object, polygon)) = frame.environment.locate(*slot) else { continue };
            let material = frame.environment.objects()[object as usize].mesh.material(polygon);
            if frame.environment.materials()[usize::from(material)].appearance(class) == Appearance::Invisible {
                continue;
            }
            there += 1;
            let Some(at) = self.faces.of_slot(frame, *slot) else { continue };
            let known = &self.faces.known[at];
            if frame.facings[usize::from(material)].one_sided && !known.faces_sensor {
                away += 1;
            } else {
                normals.push(known.normal);
            }
        }
        let landmark = matches!(placed.feature.shape, FeatureShape::Reflector { .. } | FeatureShape::Fiducial { .. });
        let given = placed.feature.properties.normal.and_then(|n| (image_from_object * n).try_normalize());
        // Corners are clockwise seen from the front: the right-hand normal points away from there.
        let of_outline = (points.len() > 2).then(|| plane_of_polygon(points)).flatten().map(|p| p.normal);
        let fiducial = matches!(placed.feature.shape, FeatureShape::Fiducial { .. });
        let front = given.or(of_outline.filter(|_| fiducial).map(|n| -n)).filter(|_| landmark);
        normals.extend(front);
        if normals.is_empty() && !(there > 0 && there == away) {
            normals.extend(given.or(of_outline));
        }
        let reason = match (placed.slots.len(), there) {
            (0, _) => None,
            (_, 0) => Some(Reason::Material),
            _ if there == away => Some(Reason::FacingAway),
            _ => None,
        };
        FeatureSurface { slots: &placed.slots, normals, front, reason, rounding }
    }

    /// Sorts samples into those that geometry alone decides and those left open.
    fn open(&mut self, own: &FeatureSurface<'_>, points: &[DVec3]) {
        self.states.clear();
        self.open.clear();
        let d = points.get(1).map_or(DVec3::ZERO, |b| *b - points[0]);
        let along = d / d.length_squared().max(f64::MIN_POSITIVE);
        for (index, piece) in self.pieces.iter().enumerate() {
            let state = match piece {
                Piece::Outside { reason, .. } => SampleState::Hidden(*reason, None),
                Piece::Inside(sample) => {
                    let range = sample.at.length();
                    match self.before_occlusion(sample, range, own) {
                        Some(reason) => SampleState::Hidden(reason, None),
                        None => {
                            let t = along.dot(sample.at - points[0]);
                            let (piece, at) = (index as u32, sample.at);
                            self.open.push(UndecidedSample {
                                piece,
                                at,
                                range,
                                t,
                                by: None,
                                share: 0.0,
                                unknown: false,
                            });
                            SampleState::Seen
                        }
                    }
                }
            };
            self.states.push(state);
        }
        self.stats.samples = self.open.len();
    }

    /// The first reason that applies whatever is in between.
    #[inline]
    pub(super) fn before_occlusion(&self, sample: &Sample, range: f64, own: &FeatureSurface<'_>) -> Option<Reason> {
        let spec = self.frame.sensor.spec();
        if range < spec.range_min {
            return Some(Reason::BelowRangeMin);
        }
        if range > spec.range_max {
            return Some(Reason::BeyondRangeMax);
        }
        if !(range > 0.0) {
            return Some(Reason::Undecided);
        }
        if own.reason.is_some() {
            return own.reason;
        }
        if own.front.is_some_and(|n| !(n.dot(sample.at) < 0.0)) {
            return Some(Reason::FacingAway);
        }
        let flat = |most: f64| own.cosine(sample.at / range).is_some_and(|cosine| cosine < most.cos());
        spec.max_incidence.is_some_and(flat).then_some(Reason::Oblique)
    }

    fn decide(
        &mut self,
        own: &FeatureSurface<'_>,
        shape: &FeatureShape,
        points: &[DVec3],
        told: Option<&[Option<u32>]>,
    ) {
        if self.frame.options.visibility == Visibility::Rays {
            return (0..self.open.len()).for_each(|i| self.by_ray(i, own));
        }
        let line = match shape {
            FeatureShape::Segment { .. } => Some(Line { a: points[0], d: points[1] - points[0] }),
            _ => None,
        };
        match (line, told) {
            (Some(line), _) => self.image_along(line, own, told),
            (None, Some(told)) => self.told_at_samples(own, told),
            (None, None) => self.image_at_samples(own),
        }
        self.stats.hidden_by_neighbours = self.open.iter().filter(|o| o.by.is_some()).count();
        let first = self.open.iter().position(|o| o.by.is_none());
        let last = self.open.iter().rposition(|o| o.by.is_none());
        let (Some(first), Some(last)) = (first, last) else { return };
        let left = first..last + 1;
        match line {
            Some(line) => self.space_along(line, left, own),
            None => self.space_at_samples(left, own),
        }
    }

    /// What was found becomes the samples' states.
    fn close(&mut self) {
        for open in &self.open {
            let state = match open.by {
                Some(slot) => SampleState::Hidden(Reason::Occluded, Some(slot)),
                None if open.unknown => SampleState::Hidden(Reason::Undecided, None),
                None => SampleState::Seen,
            };
            self.states[open.piece as usize] = state;
            let hidden = usize::from(open.by.is_some());
            self.stats.hidden_in_space += hidden;
            self.stats.undecided += usize::from(state == SampleState::Hidden(Reason::Undecided, None));
            self.stats.visible += usize::from(state == SampleState::Seen);
        }
        self.stats.hidden_in_space -= self.stats.hidden_by_neighbours;
    }

    /// The polygons seen around a segment's image, each against all of the segment.
    fn image_along(&mut self, line: Line, own: &FeatureSurface<'_>, told: Option<&[Option<u32>]>) {
        self.begin();
        match told {
            Some(told) => self.take_told(told, own),
            None => (0..self.open.len()).for_each(|i| self.gather(self.pixel_of(i), own)),
        }
        for face in &self.near {
            let known = &self.faces.known[*face as usize];
            hide_along(known, self.faces.planes_of(known), line, &mut self.open, own.rounding);
        }
    }

    /// The polygons seen around every sample, against it.
    fn image_at_samples(&mut self, own: &FeatureSurface<'_>) {
        self.center = None;
        for i in 0..self.open.len() {
            if self.moves(self.pixel_of(i)) {
                self.begin();
            }
            self.gather(self.pixel_of(i), own);
            self.hide_sample(i, own);
        }
    }

    /// The polygons told of, each against its sample.
    fn told_at_samples(&mut self, own: &FeatureSurface<'_>, told: &[Option<u32>]) {
        debug_assert_eq!(told.len(), self.open.len());
        for i in 0..self.open.len().min(told.len()) {
            self.begin();
            self.take_told(&told[i..=i], own);
            self.hide_sample(i, own);
        }
    }

    pub(super) fn take_told(&mut self, told: &[Option<u32>], own: &FeatureSurface<'_>) {
        let mut last = None;
        for slot in told.iter().flatten() {
            if last.replace(*slot) != Some(*slot) {
                self.take_slot(*slot, own);
            }
        }
    }

    pub(super) fn begin(&mut self) {
        self.asking = self.asking.wrapping_add(1).max(1);
        self.near.clear();
        self.center = None;
        self.latest = [0; LATEST];
    }

    fn pixel_of(&self, open: usize) -> DVec2 {
        match &self.pieces[self.open[open].piece as usize] {
            Piece::Inside(sample) => sample.pixel,
            Piece::Outside { .. } => DVec2::ZERO,
        }
    }

    fn nearest_pixel(&self, pixel: DVec2) -> (i64, i64) {
        self.frame.sampler.nearest_pixel(pixel)
    }

    fn moves(&self, pixel: DVec2) -> bool {
        self.center != Some(self.nearest_pixel(pixel))
    }

    /// Adds the polygons of the nine pixels around a place to `near`: those that cover rays, and that the feature does not
    /// lie on, once each.
    pub(super) fn gather(&mut self, pixel: DVec2, own: &FeatureSurface<'_>) {
        let frame = self.frame;
        let (column, row) = self.nearest_pixel(pixel);
        let before = self.center.replace((column, row));
        if before == Some((column, row)) {
            return;
        }
        let (w, h) = (i64::from(frame.images.width), i64::from(frame.images.height));
        // A step aside brings one column in, one down or up one row.
        let (mut columns, mut rows) = ([column - 1, column + 1], [(row - 1).max(0), (row + 1).min(h - 1)]);
        match before.map(|(c, r)| (column - c, row - r)) {
            Some((1, 0)) => columns[0] = column + 1,
            Some((-1, 0)) => columns[1] = column - 1,
            Some((0, 1)) => rows[0] = rows[1],
            Some((0, -1)) => rows[1] = rows[0],
            _ => {}
        }
        let wraps = frame.sampler.turn().is_some();
        for r in rows[0]..=rows[1] {
            let line = &frame.images.polygon_id[(r * w) as usize..((r + 1) * w) as usize];
            let inside = columns[0].max(0) as usize..(columns[1] + 1).clamp(0, w) as usize;
            for id in line.get(inside).into_iter().flatten() {
                self.take_id(*id, own);
            }
            if wraps && columns[0] < 0 {
                self.take_id(line[w as usize - 1], own);
            }
            if wraps && columns[1] >= w {
                self.take_id(line[0], own);
            }
        }
    }

    /// The polygon of an id, unless that is nothing or one of the latest: as of most pixels.
    #[inline]
    fn take_id(&mut self, id: u32, own: &FeatureSurface<'_>) {
        // The latest first, by itself: it is that of most.
        if id == self.latest[0] || self.latest.contains(&id) {
            return;
        }
        // The last of all goes, the first stays first in line.
        self.latest.rotate_right(1);
        self.latest[0] = id;
        if id != 0
            && let Some(slot) = self.frame.slot_of_id(id)
        {
            self.take_slot(slot, own);
        }
    }

    fn take_slot(&mut self, slot: u32, own: &FeatureSurface<'_>) {
        let Some(at) = self.faces.of_slot(self.frame, slot) else { return };
        let known = &mut self.faces.known[at];
        if known.asked != self.asking {
            known.asked = self.asking;
            if known.covers && !own.holds(known.slot) {
                self.near.push(at as u32);
            }
        }
    }

    /// Marks one sample if one of the polygons in `near` hides it.
    fn hide_sample(&mut self, index: usize, own: &FeatureSurface<'_>) {
        for face in &self.near {
            self.open[index].hide_by(&self.faces.known[*face as usize], &self.faces, own.rounding);
        }
    }

    /// Whatever may hide samples of a segment, tile by tile.
    fn space_along(&mut self, line: Line, left: Range<usize>, own: &FeatureSurface<'_>) {
        let mut near = std::mem::take(&mut self.near);
        let mut start = left.start;
        while start < left.end {
            let number = self.tiles.of(self.open[start].at).0;
            let more = self.open[start..left.end].iter().position(|o| self.tiles.of(o.at).0 != number);
            let end = more.map_or(left.end, |more| start + more);
            let some = &mut self.open[start..end];
            if some.iter().any(|o| o.by.is_none()) {
                let farthest = some.iter().map(|o| o.range).fold(0.0, f64::max);
                let ends = [some[0].at, some[some.len() - 1].at];
                let tile = self.tiles.tile(self.frame, &mut self.faces, ends[0], farthest);
                near.clear();
                near.extend(self.tiles.between(tile, &ends, own, &self.faces));
                for face in &near {
                    let known = &self.faces.known[*face as usize];
                    hide_along(known, self.faces.planes_of(known), line, some, own.rounding);
                }
            }
            start = end;
        }
        self.near = near;
    }

    /// Whatever may hide samples of a point or a patch: by tiles, unless these would serve very few.
    pub(super) fn space_at_samples(&mut self, left: Range<usize>, own: &FeatureSurface<'_>) {
        const VERY_FEW: usize = 9;
        let open = |i: &usize| self.open[*i].by.is_none();
        let mut by_tile: Vec<(u32, usize)> = left.filter(open).map(|i| (self.tiles.of(self.open[i].at).0, i)).collect();
        by_tile.sort_unstable();
        let (mut near, mut places) = (std::mem::take(&mut self.near), Vec::new());
        for some in by_tile.chunk_by(|a, b| a.0 == b.0) {
            places.clear();
            places.extend(some.iter().map(|(_, i)| self.open[*i].at));
            let farthest = some.iter().map(|(_, i)| self.open[*i].range).fold(0.0, f64::max);
            if by_tile.len() < VERY_FEW && !self.tiles.knows(some[0].0, farthest) {
                some.iter().for_each(|(_, i)| self.by_ray(*i, own));
                continue;
            }
            let tile = self.tiles.tile(self.frame, &mut self.faces, places[0], farthest);
            near.clear();
            near.extend(self.tiles.between(tile, &places, own, &self.faces));
            for (_, i) in some {
                for face in &near {
                    self.open[*i].hide_by(&self.faces.known[*face as usize], &self.faces, own.rounding);
                }
            }
        }
        self.near = near;
    }

    /// Fills `near` with the polygons in a region that may hide what is asked for.
    fn gather_from(&mut self, region: &Region, own: &FeatureSurface<'_>) {
        let frame = self.frame;
        self.found.clear();
        frame.world.index().query(frame.environment, region, &mut self.found);
        for slot in self.found.all().filter(|slot| !own.holds(*slot)) {
            if let Some(at) = self.faces.of_slot(frame, slot).filter(|at| self.faces.known[*at].covers) {
                self.near.push(at as u32);
            }
        }
    }

    /// A ray from the sensor to a sample, through the index.
    fn by_ray(&mut self, i: usize, own: &FeatureSurface<'_>) {
        let frame = self.frame;
        let UndecidedSample { at, range, .. } = self.open[i];
        self.begin();
        let direction = frame.image_from_world.transpose() * (at / range);
        let region = Region::ray(frame.world_from_sensor.translation, direction, range * (1.0 + 1e-9));
        self.gather_from(&region, own);
        self.hide_sample(i, own);
    }
}
