//! Features on one-sided polygons of a mirrored cube.

use super::{INSIDE, OUTSIDE, cube, sensors, ways, world};
use glam::{DMat3, DVec3};
use presight_features::generate::{GenerateOptions, generate};
use presight_features::{FeatureOptions, Hidden, Reason, SeenFeature, Visibility, place};
use presight_model::environment::NewObject;
use presight_model::environment::{DEFAULT_TOLERANCE, Existence, Feature, FeatureLayer, FeatureShape, Properties};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;

/// Points on the walls at x = 2 and x = 3, off the centre so that no pixel's ray hits them by chance; a patch on each
/// wall.
fn layer() -> FeatureLayer {
    let feature = |id: u32, shape: FeatureShape| Feature {
        id,
        name: None,
        object: None,
        shape,
        existence: Existence::default(),
        properties: Properties::default(),
    };
    let point = |x: f64| FeatureShape::Point { at: DVec3::new(x, 0.05, 0.06), covariance: DMat3::ZERO };
    let patch = |x: f64| {
        let corners = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]].map(|[y, z]| DVec3::new(x, y, z));
        FeatureShape::Patch { corners: corners.to_vec(), covariance: DMat3::ZERO }
    };
    let shapes = [point(2.0), point(3.0), patch(2.0), patch(3.0)];
    let features = (1..).zip(shapes).map(|(id, shape)| feature(id, shape).into()).collect();
    FeatureLayer { class: "laser".into(), tolerance: DEFAULT_TOLERANCE, features, pose_covariances: Vec::new() }
}

/// The features in view of a camera at `from` that looks along +x.
fn seen(predictor: &mut Predictor, world: &World, from: DVec3, visibility: Visibility) -> Vec<SeenFeature> {
    let (camera, _) = sensors().swap_remove(0);
    let pose = Pose { translation: from, ..Pose::IDENTITY };
    let placed = place(world, &layer()).unwrap();
    let options = FeatureOptions::default().with_visibility(visibility).with_placed(placed.clone());
    let options = options.with_hidden(Hidden::Full);
    let request = Request::default().with_features(options);
    let mut seen = predictor.predict(world, &camera, &SensorPose::new(pose), &request).unwrap().features.unwrap();
    seen.spell_out(world.environment(), &placed);
    seen.features
}

fn predictors() -> Vec<Predictor> {
    let open = |backend| Predictor::new(Options::new(backend)).ok();
    [Backend::Cpu, Backend::Gpu].into_iter().filter_map(open).collect()
}

/// The reason for a hidden feature; `None` if it is visible.
fn reason(f: &SeenFeature) -> Option<Reason> {
    assert_eq!(f.visible.is_empty(), f.visible_fraction == 0.0);
    assert!(f.visible.is_empty() || f.visible_fraction == 1.0, "the whole feature or nothing: {}", f.visible_fraction);
    f.hidden.first().map(|h| h.reason)
}

#[test]
fn a_feature_faces_away_where_its_polygon_does() {
    let away = Some(Reason::FacingAway);
    for mut predictor in predictors() {
        for (what, world_from_mesh) in ways() {
            let world = |outside| world(NewObject::from_affine("cube", world_from_mesh, cube(outside)).unwrap());
            for visibility in [Visibility::Image, Visibility::Rays] {
                let mut look = |outside, from| {
                    let seen = seen(&mut predictor, &world(outside), from, visibility);
                    seen.iter().map(reason).collect::<Vec<_>>()
                };
                // Front sides outside: the near wall shows its front. The far wall shows its back, which hides nothing.
                assert_eq!(look(true, OUTSIDE), [None, away, None, away], "{what}");
                // Front sides inside: the near wall shows its back, and the far one is visible through it.
                assert_eq!(look(false, OUTSIDE), [away, None, away, None], "{what}");
                let behind = Some(Reason::BehindSensor);
                let from_inside = look(false, INSIDE);
                assert_eq!((from_inside[0], from_inside[1]), (behind, None), "{what}");
                assert_eq!(look(true, INSIDE)[1], away, "{what}");
            }
        }
    }
}

#[test]
fn patches_of_a_mirrored_box_face_outward() {
    let options = GenerateOptions { min_area: 0.1, ..GenerateOptions::default() };
    for (what, world_from_mesh) in ways() {
        for (outside, sign) in [(true, 1.0), (false, -1.0)] {
            let world = world(NewObject::from_affine("cube", world_from_mesh, cube(outside)).unwrap());
            let object = &world.environment().objects()[0].world_from_object;
            let layer = generate(world.environment(), "laser", &options).unwrap().layer;
            let mut patches = 0;
            for f in &layer.features {
                let FeatureShape::Patch { corners, .. } = &f.shape else { continue };
                let normal = object.rotation * f.properties.normal.unwrap();
                let out = object.transform_point(corners[0]) - INSIDE;
                assert!(sign * normal.dot(out) > 0.0, "{what}, {outside}: {normal} at {out}");
                patches += 1;
            }
            // A sheared cube keeps the two walls whose planes stay upright.
            assert!(patches >= 2, "{what}: {patches}");
            place(&world, &layer).unwrap();
        }
    }
}

/// A small cube within a mirrored one has no edges: it is inside a solid.
#[test]
fn geometry_inside_a_mirrored_solid_is_left_out() {
    for (what, world_from_mesh) in ways() {
        let small = world_from_mesh * glam::DAffine3::from_scale(DVec3::splat(0.3));
        let mut environment = super::one_sided();
        for (at, outside) in [(world_from_mesh, true), (small, true)] {
            environment.insert(NewObject::from_affine("cube", at, cube(outside)).unwrap()).unwrap();
        }
        let generated = generate(&environment, "laser", &GenerateOptions::default()).unwrap();
        assert_eq!(generated.counts.buried, 12, "{what}");
    }
}
