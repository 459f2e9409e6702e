//! Generates features from the CAD model: the edges, corners, planes and smooth surfaces that a sensor may find.
//!
//! Candidates are the sides of polygons that are not clearly smooth, and the lines where polygons cross. Each candidate
//! is classified by the cross-section of all polygons that touch it, of any object ([`FeatureKind`]). Therefore
//! windings do not matter, duplicate faces count once, and neither T-junctions nor merged neighbours make borders.
//! Flush tiles have no seam, and a box on a floor has an edge along the floor.
//!
//! Known limits. The visible side of a surface is known only for closed parts that are thinner than a room and wound
//! outward. Therefore a sunk box also keeps its edges below the floor, and flush boxes that are not closed show a
//! seam. A curved rim gives no edge if its facets are shorter than the minimum length. If coplanar materials overlap,
//! the borders of both count. Two edges that cross make a corner only where one of them ends. Patches have no holes for
//! objects that stand on them.
//!
//! Every feature must meet the conditions of placement ([`crate::place`]). If joining moved one off the
//! surface by more than the layer's tolerance, it is split again, or dropped and counted.

mod candidates;
mod corners;
mod drafts;
mod effort;
mod line;
mod lines;
mod patches;
mod placing;
mod scanned;
mod smooth;
mod solids;
mod soup;
mod wings;

use drafts::{Draft, by_place, ordered};
use effort::Effort;
pub use effort::Progress;
use glam::DMat3;
use line::Line;
use presight_model::environment::{
    DEFAULT_TOLERANCE, Environment, Existence, Feature, FeatureLayer, FeatureShape, Properties,
};
use presight_model::error::{Error, Result, short};
use presight_model::geometry::Aabb;
use presight_model::printable::did_you_mean;
use presight_model::threads::parallel;
use rayon::prelude::*;
use std::sync::Arc;
use wings::{EdgeClass, EdgeClassifier, Scratch};

presight_model::words! {
    /// Kind of a generated feature. It becomes the feature's name.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
    pub enum FeatureKind {
        /// Two surfaces meet at an angle.
        Crease = "crease",
        /// A surface ends.
        Border = "border",
        /// A surface continues in a different material.
        Material = "material",
        /// Two polygons cross, away from the sides of both.
        Intersection = "intersection",
        /// Edges in different directions meet in a point.
        Corner = "corner",
        /// A vertical planar patch.
        Vertical = "vertical",
        /// A horizontal planar patch.
        Horizontal = "horizontal",
        /// A smooth surface with visible silhouettes.
        Contour = "contour",
    }
}

impl std::str::FromStr for FeatureKind {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let names = Self::ALL.map(Self::name);
        let remedy = || format!("{}choose from {}", did_you_mean(name, names), names.join(", "));
        let found = Self::ALL.into_iter().find(|k| k.name() == name);
        found.ok_or_else(|| Error::usage(format!("unknown kind {name:?}"), remedy()))
    }
}

/// Options of [`generate`].
#[derive(Clone, Debug, PartialEq)]
pub struct GenerateOptions {
    /// Kinds to generate.
    pub kinds: Vec<FeatureKind>,
    /// Minimum length of an edge, metres.
    pub min_length: f64,
    /// Minimum area of a patch, square metres.
    pub min_area: f64,
    /// Minimum deviation of a crease from flat, radians.
    pub crease: f64,
    /// Maximum deviation of a patch from vertical or horizontal, radians.
    pub tilt: f64,
    /// Standard deviation of positions along each axis, metres.
    pub sigma: f64,
    /// Maximum distance of facets from their plane, metres; 0 if planes are exact. `None`: for each mesh, three
    /// standard deviations of its own noise, at most three times `sigma`. Designed meshes have no noise.
    pub flatness: Option<f64>,
    /// Limits candidates to the neighbourhood of this box (world). Features there are as without a limit, but numbered
    /// from 1.
    pub region: Option<Aabb>,
}

impl Default for GenerateOptions {
    fn default() -> Self {
        Self {
            kinds: FeatureKind::ALL.to_vec(),
            min_length: 0.05,
            min_area: 0.25,
            crease: 30f64.to_radians(),
            tilt: 1f64.to_radians(),
            sigma: 0.01,
            flatness: None,
            region: None,
        }
    }
}

/// Numbers of generated features and of dropped candidates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FeatureCounts {
    /// Features by kind, as in [`FeatureKind::ALL`].
    pub made: [usize; 8],
    /// Polygons examined.
    pub polygons: usize,
    /// Polygons invisible to the class.
    pub invisible: usize,
    /// Lines classified, after joining collinear ones.
    pub candidates: usize,
    /// Lines dropped before classification, because they are shorter than the minimum length.
    pub short: usize,
    /// Lines without an edge: smooth, or a seam.
    pub flat: usize,
    /// Lines entirely inside solids.
    pub buried: usize,
    /// Features that joining moved off the surface and that could not be split.
    pub off: usize,
    /// Objects whose planes are not exact.
    pub uneven: usize,
}

impl FeatureCounts {
    /// Number of features of a kind.
    pub fn of(&self, kind: FeatureKind) -> usize {
        self.made[kind as usize]
    }
}

/// The result of [`generate`].
#[derive(Clone, Debug, PartialEq)]
pub struct GeneratedLayer {
    /// The features in the frames of their objects, sorted by object, kind and position, contours last. Ids start at 1.
    pub layer: FeatureLayer,
    /// Numbers of features and candidates.
    pub counts: FeatureCounts,
    /// Maximum distance of facets from their plane over all objects, metres; 0 if all planes are exact.
    pub flatness: f64,
}

/// Generates the feature layer of a sensor class from the polygons of an environment. Materials invisible to the class
/// give no features; transparent ones do. Equal inputs give equal layers.
///
/// ```
/// use presight::features::{FeatureKind, GenerateOptions, generate};
/// use presight::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
/// use presight::Pose;
/// use glam::Vec3;
///
/// // A square tile has four open borders, which meet in four corners.
/// let mut environment = Environment::new();
/// let clay = environment.add_material(Material::named("clay"))?;
/// let corners = vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y];
/// let mesh = Mesh::new("tile", corners, vec![Polygon::new(vec![0, 1, 2, 3], clay)], PolygonOrder::Given)?;
/// environment.insert(NewObject::new("tile", Pose::IDENTITY, mesh.into()))?;
///
/// let generated = generate(&environment, "video", &GenerateOptions::default())?;
/// assert_eq!(generated.counts.of(FeatureKind::Border), 4);
/// assert_eq!(generated.counts.of(FeatureKind::Corner), 4);
/// assert_eq!(generated.counts.of(FeatureKind::Horizontal), 1);
/// assert_eq!(generated.layer.features.len(), 9);
/// # Ok::<(), presight::Error>(())
/// ```
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] if an option is not finite or out of range, or the class is empty;
/// [`presight_model::ErrorKind::Invalid`] naming a place where too many polygons overlap
/// ([`presight_model::limits::MAX_FEATURE_STEPS`]); the errors of [`presight_model::Threads::new`].
pub fn generate(environment: &Environment, class: &str, options: &GenerateOptions) -> Result<GeneratedLayer> {
    generate_with_progress(environment, class, options, &|_| {})
}

/// Same as [`generate`], and reports progress to `watch`, from any thread.
///
/// # Errors
/// The errors of [`generate`].
pub fn generate_with_progress(
    environment: &Environment,
    class: &str,
    options: &GenerateOptions,
    watch: &(dyn Fn(Progress) + Sync),
) -> Result<GeneratedLayer> {
    generate_with(environment, class, options, &Effort::new(environment, watch))
}

fn generate_with(
    environment: &Environment,
    class: &str,
    options: &GenerateOptions,
    effort: &Effort<'_>,
) -> Result<GeneratedLayer> {
    options.check()?;
    if class.is_empty() {
        return Err(Error::usage("the sensor class is empty", "give a class such as \"video\""));
    }
    parallel(|| generate_checked(environment, class, options, effort))?
}

fn generate_checked(
    environment: &Environment,
    class: &str,
    options: &GenerateOptions,
    effort: &Effort<'_>,
) -> Result<GeneratedLayer> {
    let touch = options.touch();
    let near = options.region.map(|r| soup::grown(&r, 10.0 * touch));
    let soup = soup::Soup::new(environment, class, near.as_ref());
    let mut counts = FeatureCounts {
        polygons: soup.faces.len() + soup.equal,
        invisible: soup.invisible,
        ..FeatureCounts::default()
    };
    let wants = |kinds: &[FeatureKind]| options.kinds.iter().any(|k| kinds.contains(k));
    let mut drafts: Vec<Draft> = Vec::new();
    if wants(&FeatureKind::ALL[..5]) {
        let edges = edges(environment, &soup, options, near.as_ref(), &mut counts, effort)?;
        if wants(&[FeatureKind::Corner]) {
            let corners = corners::corners(&edges, &lines::Nearness { environment, touch }, options.crease, effort)?;
            drafts.extend(corners.into_iter().map(|(p, object)| Draft::new(FeatureKind::Corner, object, vec![p])));
        }
        let wanted = edges.iter().filter(|e| wants(&[e.kind]));
        drafts.extend(wanted.map(|e| Draft::new(e.kind, e.object, ordered(e.start, e.end))));
    }
    let smooth = smooth::surfaces(environment, class, options, near.as_ref(), effort)?;
    let flatness = smooth.iter().map(|s| s.flatness).fold(0.0, f64::max);
    counts.uneven = smooth.iter().filter(|s| s.flatness > 0.0).count();
    if wants(&FeatureKind::ALL[5..7]) {
        let is_uneven = |object: u32| smooth[object as usize].flatness > 0.0;
        let patches = patches::patches(&soup, is_uneven, options.tilt, options.min_area, touch, effort)?;
        let wanted = patches.into_iter().filter(|p| {
            wants(&[p.kind]) && near.is_none_or(|n| candidates::meet(&n, &Aabb::of(p.corners.iter().copied())))
        });
        drafts.extend(wanted.map(Draft::from));
    }
    drafts.extend(smooth.into_iter().flat_map(|s| s.drafts));
    let drafts = placing::on_the_surface(&soup, drafts, options.min_area, &mut counts.off, effort)?;
    let layer = FeatureLayer {
        tolerance: (scanned::LAYER * flatness).max(DEFAULT_TOLERANCE),
        ..layer_of(environment, class, options, drafts, &mut counts)
    };
    Ok(GeneratedLayer { layer, counts, flatness })
}

impl GenerateOptions {
    /// Checks every number.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] naming the option that is not finite or out of range.
    pub fn check(&self) -> Result<()> {
        let quarter = std::f64::consts::FRAC_PI_2;
        // Users give angles in degrees, so they are shown to a millionth of a degree.
        let degrees = |angle: f64| format!("{} degrees", (angle.to_degrees() * 1e6).round() / 1e6);
        let flatness = self.flatness.unwrap_or(0.0);
        let checks = [
            ("the minimum length", self.min_length, 1e-4..=1e6, short(self.min_length), "give 0.0001 m .. 1000 km"),
            ("the minimum area", self.min_area, 0.0..=1e12, short(self.min_area), "give square metres from 0"),
            ("the crease angle", self.crease, 0.01..=quarter, degrees(self.crease), "give 0.6 to 90 degrees"),
            ("the tilt", self.tilt, 0.0..=0.5, degrees(self.tilt), "give 0 to 28 degrees"),
            ("the standard deviation", self.sigma, 0.0..=1e6, short(self.sigma), "give metres from 0"),
            ("the flatness", flatness, 0.0..=1.0, short(flatness), "give 0 to 1 m"),
        ];
        let wrong = checks.into_iter().find(|(_, value, range, ..)| !range.contains(value));
        wrong.map_or(Ok(()), |(what, _, _, shown, remedy)| {
            Err(Error::usage(format!("{what} of {shown} is out of its range"), remedy))
        })
    }

    /// Maximum distance between touching parts, metres: half a millimetre, or less for short edges.
    fn touch(&self) -> f64 {
        (0.02 * self.min_length).min(5e-4)
    }
}

/// Returns all edges in the world without duplicates, with collinear ones joined and short ones dropped.
fn edges(
    environment: &Environment,
    soup: &soup::Soup,
    options: &GenerateOptions,
    near: Option<&Aabb>,
    counts: &mut FeatureCounts,
    effort: &Effort<'_>,
) -> Result<Vec<Line>> {
    let touch = options.touch();
    let objects = environment.objects();
    let sizes: Vec<f64> = objects.iter().map(|o| o.world_bounds().size()).collect();
    let solids = solids::Solids::new(soup);
    let mut candidates = candidates::sides_of_polygons(soup, options.crease);
    candidates.extend(candidates::crossings(soup, touch, &sizes, near, effort)?);
    candidates.retain(|line| near.is_none_or(|n| candidates::meet(n, &line.bounds())));
    let nearness = lines::Nearness { environment, touch };
    let joined = lines::merged(&candidates, &nearness, true, effort)?;
    let (long, short): (Vec<Line>, Vec<Line>) = joined.into_iter().partition(|l| l.length() >= options.min_length);
    (counts.candidates, counts.short) = (long.len(), short.len());
    let judge = EdgeClassifier { soup, effort, solids: &solids, touch, crease: options.crease };
    let steps = effort.stage("edges", long.len());
    let judged: Vec<Vec<(f64, f64, EdgeClass)>> = long
        .par_iter()
        .map_init(Scratch::default, |scratch, line| {
            let mut parts = Vec::new();
            judge.judge(line, scratch, &mut parts)?;
            steps.step();
            Ok(parts)
        })
        .collect::<Result<_>>()?;
    let mut shown = Vec::new();
    for (line, parts) in long.iter().zip(judged) {
        let before = shown.len();
        for (from, to, verdict) in &parts {
            if let EdgeClass::Shows(kind) = verdict {
                shown.push(Line { kind: *kind, ..line.part(*from, *to) });
            }
        }
        if shown.len() == before {
            let buried = parts.iter().all(|p| p.2 == EdgeClass::Buried);
            if buried { counts.buried += 1 } else { counts.flat += 1 }
        }
    }
    let mut edges = lines::merged(&shown, &nearness, false, effort)?;
    edges.retain(|l| l.length() >= options.min_length);
    edges.sort_by_key(|l| (l.kind == FeatureKind::Intersection, l.object));
    lines::once(&edges, &nearness, options.min_length, effort)
}

fn layer_of(
    environment: &Environment,
    class: &str,
    options: &GenerateOptions,
    drafts: Vec<Draft>,
    counts: &mut FeatureCounts,
) -> FeatureLayer {
    let objects = environment.objects();
    let mut drafts: Vec<Draft> = drafts
        .into_iter()
        .map(|d| {
            let o = d.object as usize;
            d.placed(&objects[o].world_from_object)
        })
        .collect();
    let places = |a: &Draft, b: &Draft| {
        let unequal = a.points.iter().zip(&b.points).map(|(p, q)| by_place(p, q)).find(|o| o.is_ne());
        unequal.unwrap_or_else(|| a.points.len().cmp(&b.points.len()))
    };
    // Contours come last, so that other features keep the numbers that they have without contours.
    let key = |d: &Draft| (d.kind == FeatureKind::Contour, d.object, d.kind);
    drafts.sort_by(|a, b| key(a).cmp(&key(b)).then_with(|| places(a, b)));
    let covariance = DMat3::IDENTITY * (options.sigma * options.sigma);
    // Rounded to the precision in files.
    let crease_deg = (options.crease.to_degrees() * 1e6).round() / 1e6;
    let feature = |(id, draft): (u32, Draft)| {
        counts.made[draft.kind as usize] += 1;
        let shape = match draft.points[..] {
            [anchor] if draft.kind == FeatureKind::Contour => FeatureShape::Contour { anchor, crease_deg, covariance },
            [at] => FeatureShape::Point { at, covariance },
            [a, b] => FeatureShape::Segment { ends: [a, b], covariances: [covariance; 2], cross: DMat3::ZERO },
            _ => FeatureShape::Patch { corners: draft.points, covariance },
        };
        Feature {
            id,
            name: Some(draft.kind.name().to_owned()),
            object: Some(objects[draft.object as usize].name.clone()),
            shape,
            existence: Existence::default(),
            properties: Properties { normal: draft.normal, ..Properties::default() },
        }
    };
    let features = (1..).zip(drafts).map(feature).map(Arc::new).collect();
    FeatureLayer { class: class.to_owned(), tolerance: DEFAULT_TOLERANCE, features, pose_covariances: Vec::new() }
}
