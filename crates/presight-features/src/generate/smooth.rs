//! Features of whole surfaces: the planes of scanned meshes, and contours.

use super::candidates::meet;
use super::drafts::Draft;
use super::effort::Effort;
use super::{FeatureKind, GenerateOptions, scanned};
use presight_model::contour::{self, MeshEdges};
use presight_model::environment::Environment;
use presight_model::error::Result;
use presight_model::flat::{FlatOptions, FlatRest, FlatSurfaces};
use presight_model::geometry::Aabb;
use rayon::prelude::*;

/// The features of an object.
#[derive(Default)]
pub(super) struct SmoothSurfaces {
    /// Patches that are not exactly plane, and contours.
    pub drafts: Vec<Draft>,
    /// Maximum distance of facets from their plane, metres; 0 if planes are exact.
    pub flatness: f64,
}

/// The features of all objects, in their order.
pub(super) fn surfaces(
    environment: &Environment,
    class: &str,
    options: &GenerateOptions,
    near: Option<&Aabb>,
    effort: &Effort<'_>,
) -> Result<Vec<SmoothSurfaces>> {
    let objects = environment.objects();
    let steps = effort.stage("smooth surfaces", objects.len());
    let is_near = |o: usize| near.is_none_or(|n| meet(n, &objects[o].world_bounds()));
    let wants = options.kinds.iter().any(|k| FeatureKind::ALL[5..].contains(k));
    let of_object = |o: usize| {
        let found = match wants && is_near(o) {
            true => of_object(environment, o, class, options, near)?,
            false => SmoothSurfaces::default(),
        };
        steps.step();
        Ok(found)
    };
    (0..objects.len()).into_par_iter().map(of_object).collect()
}

fn of_object(
    environment: &Environment,
    number: usize,
    class: &str,
    options: &GenerateOptions,
    near: Option<&Aabb>,
) -> Result<SmoothSurfaces> {
    let object = &environment.objects()[number];
    let pose = object.world_from_object;
    let edges = MeshEdges::new(environment, object, class)?;
    let limits = FlatOptions {
        tolerance: options.flatness,
        max_noise: options.sigma,
        min_area: options.min_area.max(options.min_length * options.min_length),
    };
    let flat = FlatSurfaces::new(&edges, &limits);
    let wants = |kind: FeatureKind| options.kinds.contains(&kind);
    let is_near = |draft: &Draft| near.is_none_or(|n| meet(n, &Aabb::of(draft.points.iter().copied())));
    let patches = scanned::patches(object, number as u32, &flat, options.tilt, limits.min_area);
    let mut drafts: Vec<Draft> = patches.into_iter().filter(|d| wants(d.kind) && is_near(d)).collect();
    if wants(FeatureKind::Contour) {
        let mut rest = (flat.tolerance > 0.0).then(|| FlatRest::new(&edges, &flat));
        let keeps = |polygons: &[u32]| rest.as_mut().is_none_or(|r| r.is_curved(polygons, options.min_length));
        let found = contour::surfaces(environment, number as u32, &edges, options.crease, keeps).into_iter();
        let wanted = found.filter(|surface| {
            let in_world = surface.bounds.transformed(&pose.to_affine());
            surface.bounds.size() >= options.min_length && near.is_none_or(|n| meet(n, &in_world))
        });
        let draft = |s: contour::SmoothSurface| {
            Draft::new(FeatureKind::Contour, number as u32, vec![pose.transform_point(s.anchor)])
        };
        drafts.extend(wanted.map(draft));
    }
    Ok(SmoothSurfaces { drafts, flatness: flat.tolerance })
}
