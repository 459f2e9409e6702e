//! Processes a whole frame: searches each predicted feature in its region, matches and classifies it.

use super::classes::{FeatureClass, classify, unmatched, verdicts_along};
use super::corners::{CornerOptions, corners_in};
use super::edges::{EdgeOptions, ExpectedEdge, edges_near};
use super::jumps::{JumpOptions, jumps_near};
use super::reflectors::{ReflectorOptions, range_to, reflectors_in};
use super::region::PixelBox;
use super::tags::{is_sought, tags_in};
use crate::matching::{Detection, ExpectedFeature, ExpectedProperties, Marker, Matcher, Shape, UncertainValue, unwrap};
use crate::verdict::{Verdict, Verdicts};
use glam::{DMat2, DMat3, DVec2, DVec3};
use presight_features::{FeaturePrediction, SeenFeature, VisibleInterval};
use presight_model::environment::FeatureShape;
use presight_model::error::Result;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::measured::{Frame, GreyImage};
use presight_model::sensor::Sensor;

presight_model::options! {
    /// Options of [`find_features`].
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct FindOptions {
        /// For grey images.
        edges: EdgeOptions = EdgeOptions { min_support: 0.7, ..EdgeOptions::default() }, with_edges;
        /// For grey images.
        corners: CornerOptions = CornerOptions::default(), with_corners;
        /// For range images.
        jumps: JumpOptions = JumpOptions { min_support: 0.7, ..JumpOptions::default() }, with_jumps;
        /// For scans with intensities.
        reflectors: ReflectorOptions = ReflectorOptions::default(), with_reflectors;
        /// Covariance of the sensor's position, world axes, metres squared, used to match reflectors by range. `None`
        /// if unknown; then a reflector at any range matches.
        place: Option<DMat3> = None, with_place;
        /// Search distance across an edge, in standard deviations of its predicted position.
        deviations: f64 = 3.0, with_deviations;
        /// Standard deviation of feature positions in the model, pixels, in addition to that of the pose.
        model: f64 = 0.3, with_model;
    }
}

/// A visible part of a predicted feature, and its classification.
#[derive(Clone, Debug, PartialEq)]
pub struct FeatureFinding {
    /// The id of the feature.
    pub id: u32,
    /// World points, metres: both ends of a part of an edge, a point, or the four corners of a fiducial.
    pub points_world: Vec<DVec3>,
    /// Covariance of the modelled position, world axes, metres squared; for points, fiducials and reflectors.
    pub place: DMat3,
    /// Probability that the feature exists.
    pub existence: f64,
    /// The predicted shape in the image.
    pub predicted: Shape,
    /// The classification; a match refers to [`FeatureFindings::detections`].
    pub class: FeatureClass,
}

/// Predicted features found and not found in a frame (paper section 3.5).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FeatureFindings {
    /// All detections, each once.
    pub detections: Vec<Detection>,
    /// The predicted features that can be detected in this kind of frame.
    pub features: Vec<FeatureFinding>,
    /// Detections that match no predicted feature.
    pub only_found: Vec<usize>,
}

impl FeatureFindings {
    /// Matched features with their detections.
    pub fn matched(&self) -> impl Iterator<Item = (&FeatureFinding, &Detection)> {
        self.features.iter().filter_map(|f| match f.class {
            FeatureClass::Matched(at) => Some((f, &self.detections[at])),
            _ => None,
        })
    }

    /// Classifies unmatched features by measured ranges: *nearer* ranges mean that an unknown object occludes the
    /// feature, *farther* ones that it is missing.
    #[doc(hidden)]
    pub fn explain(&mut self, ranges: &MeasuredRanges<'_>) {
        for feature in self.features.iter_mut().filter(|f| f.class == FeatureClass::Undecidable) {
            feature.class = match feature.predicted {
                Shape::Reflector(_) => unmatched(&upon(ranges, &feature.points_world)),
                _ => unmatched(&beside(ranges, &feature.points_world)),
            };
        }
    }

    /// A copy of the findings in which a feature counts as unmatched.
    pub fn without(&self, id: u32) -> Self {
        let mut some = self.clone();
        let own = some.features.iter_mut().filter(|f| f.id == id);
        own.for_each(|f| f.class = FeatureClass::Undecidable);
        some
    }

    /// Number of features in a class, by its name ([`FeatureClass::name`]).
    pub fn count(&self, class: &str) -> usize {
        self.features.iter().filter(|f| f.class.name() == class).count()
    }
}

/// Ranges measured at the same time, by the same sensor or a nearby one. They show why a feature was not found.
#[derive(Clone, Copy, Debug)]
pub struct MeasuredRanges<'a> {
    /// Their comparison with the prediction.
    pub verdicts: &'a Verdicts,
    /// The sensor that measured them.
    pub sensor: &'a Sensor,
    /// Its pose, body axes.
    pub pose: SensorPose,
    /// Echo intensities: where the echo is not bright, there is no reflector.
    pub intensities: Option<&'a GreyImage>,
}

impl MeasuredRanges<'_> {
    /// True if the echo there is too weak for a reflector. An intensity of 0 means that the sensor reports none.
    fn is_dark_at(&self, place: DVec2) -> bool {
        let Some(image) = self.intensities else { return false };
        let [c, r] = [place.x.round(), place.y.round()];
        let inside = c >= 0.0 && r >= 0.0 && c < f64::from(image.width()) && r < f64::from(image.height());
        let told = if inside { f64::from(image.pixel(c as u32, r as u32)) } else { f64::NAN };
        told > 0.0 && told < ReflectorOptions::default().least
    }
}

/// Distance from an edge at which ranges are evaluated, pixels: on the edge itself, hardly any verdict is certain.
const BESIDE: f64 = 2.5;

/// Searches each predicted feature of a frame in its region, and matches all detections at least total cost. Grey
/// images are searched for edges, corners and, with the Cargo feature `fiducials`, fiducials ([`is_sought`]); range
/// images for depth edges and, if they have intensities, reflectors. The prediction must be for the frame's sensor at
/// `pose` and have regions of interest ([`presight_predict::Request::with_regions`]); features without a
/// region are skipped. [`FeatureFindings::explain`] then classifies the features that were not found.
///
/// # Errors
/// Errors of [`classify`]; [`presight_model::ErrorKind::System`] if the fiducial library runs out of memory.
pub fn find_features(
    frame: &Frame,
    pose: &SensorPose,
    predicted: &FeaturePrediction,
    options: &FindOptions,
) -> Result<FeatureFindings> {
    let mut findings = FeatureFindings::default();
    let mut expected = Vec::new();
    let view = View { sensor: frame.sensor(), world_from_sensor: &pose.world_from_sensor() };
    let turn = presight_features::turn(frame.sensor());
    for seen in &predicted.features {
        for part in parts(&view, seen, options).into_iter().filter(|part| can_be_found(frame, part)) {
            for detection in look(frame, &part, options)? {
                if !findings.detections.iter().any(|known| is_same(known, &detection, turn)) {
                    findings.detections.push(detection);
                }
            }
            findings.features.push(FeatureFinding {
                id: seen.feature.id,
                points_world: part.points_world,
                place: DMat3::ZERO,
                existence: seen.existence,
                predicted: part.expected.shape.clone(),
                class: FeatureClass::Undecidable,
            });
            expected.push(part.expected);
        }
    }
    let matcher = matcher(frame);
    let classes = classify(&expected, &findings.detections, &matcher, &[])?;
    for (feature, class) in findings.features.iter_mut().zip(classes.features) {
        feature.class = class;
    }
    findings.only_found = classes.only_found;
    Ok(findings)
}

/// Expected number of bright spots per scan column that are not reflectors of the layer: one false spot in a scan of
/// 1,000 beams.
const CLUTTER_OF_A_COLUMN: f64 = 1e-3;
/// Number of pixel rows with the same effect where the row is unknown: sqrt(2 pi V) of its variance V
/// ([`super::reflectors::UNKNOWN`]). Dividing by it gives the density per column.
const ROWS: f64 = 2507.0;

fn matcher(frame: &Frame) -> Matcher {
    let matcher = Matcher { turn: presight_features::turn(frame.sensor()), ..Matcher::default() };
    match frame.intensities().is_some() && frame.sensor().height() == 1 {
        true => Matcher { clutter_density: CLUTTER_OF_A_COLUMN / ROWS, ..matcher },
        false => matcher,
    }
}

/// A part of a feature to search.
struct Part {
    points_world: Vec<DVec3>,
    expected: ExpectedFeature,
    edge: Option<ExpectedEdge>,
}

impl Part {
    fn is_reflector(&self) -> bool {
        matches!(self.expected.shape, Shape::Reflector(_))
    }
}

/// The viewpoint of a prediction.
struct View<'a> {
    sensor: &'a Sensor,
    world_from_sensor: &'a Pose,
}

impl View<'_> {
    /// Pixels of world points; `None` if one of them is not imaged.
    fn pixels(&self, points_world: &[DVec3]) -> Option<Vec<DVec2>> {
        let image_from_world = (*self.world_from_sensor * crate::verdict::body_from_image(self.sensor)).inverse();
        let pixel = |p: &DVec3| self.sensor.project(image_from_world.transform_point(*p)).map(DVec2::from);
        points_world.iter().map(pixel).collect()
    }
}

/// Fraction of a fiducial that must be visible: a partly covered one cannot be read.
const WHOLE: f64 = 0.95;

/// A fiducial that is visible as a whole.
fn fiducial(view: &View<'_>, seen: &SeenFeature, covariances: Vec<DMat2>, window: [f64; 4]) -> Option<Part> {
    let FeatureShape::Fiducial { family, code, .. } = &seen.feature.shape else { return None };
    if seen.visible_fraction < WHOLE {
        return None;
    }
    let corners: [DVec2; 4] = view.pixels(&seen.points_world)?.try_into().ok()?;
    // The region covers the black square. The white border around it is one cell wide; the square has 6 to 8 cells.
    let side = (0..4).map(|k| corners[k].distance(corners[(k + 1) % 4])).fold(0.0, f64::max);
    let margin = 0.25 * side + 2.0;
    let [x0, y0, x1, y1] = window;
    let marker = Some(Marker { family: family.clone(), code: *code });
    Some(Part {
        points_world: seen.points_world.clone(),
        expected: ExpectedFeature {
            shape: Shape::Fiducial(corners),
            covariances,
            window: [x0 - margin, y0 - margin, x1 + margin, y1 + margin],
            properties: ExpectedProperties { marker, ..ExpectedProperties::default() },
        },
        edge: None,
    })
}

/// A reflector at its predicted range. `own` bounds its position covariance in every direction.
fn reflector(
    view: &View<'_>,
    (at, pixel): (DVec3, DVec2),
    (covariance, own): (DMat2, DMat3),
    window: [f64; 4],
    options: &FindOptions,
) -> Part {
    let image_from_world = (*view.world_from_sensor * crate::verdict::body_from_image(view.sensor)).inverse();
    let mean = range_to(view.sensor, image_from_world.transform_point(at));
    let ray = (at - view.world_from_sensor.translation).normalize_or_zero();
    let variance = options.place.map(|place| ray.dot((place + own) * ray).max(0.0));
    let range = variance.map(|variance| UncertainValue { mean, variance });
    let [x0, y0, x1, y1] = window;
    // A scan with a single row is searched in that row.
    let [y0, y1] = if view.sensor.height() == 1 { [y0.min(-0.5), y1.max(0.5)] } else { [y0, y1] };
    Part {
        points_world: vec![at],
        expected: ExpectedFeature {
            shape: Shape::Reflector(pixel),
            covariances: vec![covariance],
            window: [x0, y0, x1, y1],
            properties: ExpectedProperties { range, ..ExpectedProperties::default() },
        },
        edge: None,
    }
}

/// The visible parts of a segment that are long enough, or a point, a fiducial, or a reflector.
fn parts(view: &View<'_>, seen: &SeenFeature, options: &FindOptions) -> Vec<Part> {
    let Some(covariances) = &seen.image_covariance else { return Vec::new() };
    let model = DMat2::from_diagonal(DVec2::splat(options.model * options.model));
    let covariances: Vec<DMat2> = covariances.iter().map(|c| DMat2::from_cols_array_2d(c) + model).collect();
    let properties = ExpectedProperties::default();
    match (&seen.feature.shape, &seen.points_world[..], &covariances[..], seen.visible.first(), seen.roi) {
        (FeatureShape::Segment { .. }, [a, b], [first, last], ..) => {
            let part = |(part, edge): (&VisibleInterval, ExpectedEdge)| {
                let ends = part.pixels;
                let [x, y] = [0, 1].map(|axis| (ends[0][axis].min(ends[1][axis]), ends[0][axis].max(ends[1][axis])));
                let reach = edge.reach;
                Part {
                    points_world: part.t.map(|t| a.lerp(*b, t)).into(),
                    expected: ExpectedFeature {
                        shape: Shape::Segment { ends, corners: [false; 2] },
                        covariances: part.t.map(|t| *first * (1.0 - t) + *last * t).into(),
                        window: [x.0 - reach, y.0 - reach, x.1 + reach, y.1 + reach],
                        properties: properties.clone(),
                    },
                    edge: Some(edge),
                }
            };
            ExpectedEdge::of_parts(seen, options.deviations).into_iter().map(part).collect()
        }
        (FeatureShape::Point { .. }, [at], [covariance], Some(visible), Some(window)) => vec![Part {
            points_world: vec![*at],
            expected: ExpectedFeature {
                shape: Shape::Point(visible.pixels[0]),
                covariances: vec![*covariance],
                window,
                properties,
            },
            edge: None,
        }],
        (FeatureShape::Reflector { covariance: own, .. }, [at], [covariance], Some(visible), Some(window)) => {
            let own = DMat3::from_diagonal(DVec3::splat(own.x_axis.x + own.y_axis.y + own.z_axis.z));
            vec![reflector(view, (*at, visible.pixels[0]), (*covariance, own), window, options)]
        }
        (shape @ FeatureShape::Fiducial { .. }, .., Some(_), Some(window)) if is_sought(shape) => {
            fiducial(view, seen, covariances, window).into_iter().collect()
        }
        _ => Vec::new(),
    }
}

/// Reflectors can only be found by intensities.
fn can_be_found(frame: &Frame, part: &Part) -> bool {
    frame.intensities().is_some() || !part.is_reflector()
}

fn look(frame: &Frame, part: &Part, options: &FindOptions) -> Result<Vec<Detection>> {
    let found = match (frame.grey(), &part.edge) {
        (Some(image), Some(edge)) => {
            edges_near(image, edge, &options.edges).into_iter().map(|found| found.detection).collect()
        }
        (Some(image), None) => match &part.expected.properties.marker {
            Some(marker) => tags_in(image, PixelBox(part.expected.window), &marker.family)?,
            None => corners_in(image, PixelBox(part.expected.window), &options.corners),
        },
        (None, Some(edge)) => {
            jumps_near(frame, edge, &options.jumps).into_iter().map(|found| found.detection).collect()
        }
        (None, None) => match frame.intensities() {
            Some(image) if part.is_reflector() => {
                let window = PixelBox(part.expected.window);
                reflectors_in(frame, image, window, &options.reflectors)?.into_iter().map(|f| f.detection).collect()
            }
            _ => Vec::new(),
        },
    };
    Ok(found)
}

/// True if two detections from different regions are the same: less than a pixel apart, and overlapping.
fn is_same(a: &Detection, b: &Detection, turn: Option<f64>) -> bool {
    match (&a.shape, &b.shape) {
        (Shape::Segment { ends: p, .. }, Shape::Segment { ends: q, .. }) => {
            let way = p[1] - p[0];
            let along = way.normalize_or_zero();
            let off = q.map(|q| along.perp_dot(q - p[0]).abs());
            let at = q.map(|q| along.dot(q - p[0]));
            let both = at[0].max(at[1]).min(way.length()) - at[0].min(at[1]).max(0.0);
            off[0].max(off[1]) < 1.0 && both > 0.5 * way.length().min((at[1] - at[0]).abs())
        }
        (Shape::Point(p), Shape::Point(q)) => p.distance(*q) < 1.0,
        // A reflector behind another has a different range.
        (Shape::Reflector(p), Shape::Reflector(q)) => {
            let off = *q + DVec2::new(unwrap(turn, p.x, q.x), 0.0) - *p;
            off.length() < 0.5 && a.properties.range == b.properties.range
        }
        (Shape::Fiducial(_), Shape::Fiducial(_)) => {
            a.properties.marker == b.properties.marker && a.shape.centre().distance(b.shape.centre()) < 1.0
        }
        _ => false,
    }
}

/// Verdicts at a reflector, which may stand free. Where ranges meet its surface but the echo is weak, it is missing.
fn upon(ranges: &MeasuredRanges<'_>, points_world: &[DVec3]) -> [usize; 7] {
    let view = View { sensor: ranges.sensor, world_from_sensor: &ranges.pose.world_from_sensor() };
    let Some([at]) = view.pixels(points_world).as_deref().map(|p| [p[0]]) else { return [0; 7] };
    // The other beams need not have met it.
    let at = if ranges.sensor.height() == 1 { DVec2::new(at.x, 0.0) } else { at };
    let mut counts = verdicts_along(ranges.verdicts, [at; 2], 0.0);
    if ranges.is_dark_at(at) {
        counts[Verdict::Farther as usize] += std::mem::take(&mut counts[Verdict::Confirmed as usize]);
    }
    counts
}

/// Verdicts near a feature, where the range sensor sees its place.
fn beside(ranges: &MeasuredRanges<'_>, points_world: &[DVec3]) -> [usize; 7] {
    let view = View { sensor: ranges.sensor, world_from_sensor: &ranges.pose.world_from_sensor() };
    match view.pixels(points_world).as_deref() {
        Some([a, b]) => verdicts_along(ranges.verdicts, [*a, *b], BESIDE),
        // Around a point: above, below, left and right.
        Some([at]) => {
            let half = DVec2::new(BESIDE, 0.0);
            let mut counts = verdicts_along(ranges.verdicts, [*at - half, *at + half], BESIDE);
            let more = verdicts_along(ranges.verdicts, [*at - half.perp(), *at + half.perp()], BESIDE);
            counts.iter_mut().zip(more).for_each(|(c, m)| *c += m);
            counts
        }
        // A fiducial is flat: the range at its middle shows whether its surface is there.
        Some(corners @ [_, _, _, _]) => {
            let middle = 0.25 * corners.iter().sum::<DVec2>();
            verdicts_along(ranges.verdicts, [middle; 2], 0.0)
        }
        _ => [0; 7],
    }
}
