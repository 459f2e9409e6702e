//! Small scenes whose counts follow from their geometry.

use glam::{DAffine3, DVec3, Vec3};
use presight_features::generate::{FeatureKind, GenerateOptions, generate};
use presight_model::environment::{Appearance, Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::environment::{CUBOID_FACES, cuboid_corners};
use presight_model::geometry::Pose;
use std::sync::Arc;

/// A loop of corners in a material.
pub(super) type Loop = (Vec<Vec3>, u16);

pub(super) fn mesh(loops: &[Loop]) -> Arc<Mesh> {
    let mut vertices = Vec::new();
    let mut polygons = Vec::new();
    for (corners, material) in loops {
        let first = vertices.len() as u32;
        vertices.extend(corners);
        polygons.push(Polygon::new((first..vertices.len() as u32).collect(), *material));
    }
    Arc::new(Mesh::new("m", vertices, polygons, PolygonOrder::Given).unwrap())
}

/// The faces of a box, wound outward.
pub(super) fn cuboid(least: Vec3, most: Vec3) -> Vec<Loop> {
    let corners = cuboid_corners(least, most);
    CUBOID_FACES.iter().map(|f| (f.iter().map(|i| corners[*i as usize]).collect(), 0)).collect()
}

fn rectangle(x: [f32; 2], y: [f32; 2], z: f32, material: u16) -> Loop {
    (
        vec![Vec3::new(x[0], y[0], z), Vec3::new(x[1], y[0], z), Vec3::new(x[1], y[1], z), Vec3::new(x[0], y[1], z)],
        material,
    )
}

/// Two materials, and a third one that is invisible to video.
pub(super) fn empty() -> Environment {
    let mut environment = Environment::new();
    for name in ["grey", "red"] {
        environment.add_material(Material::named(name)).unwrap();
    }
    let mut fog = Material::named("fog");
    fog.appearance.insert("video".into(), Appearance::Invisible);
    environment.add_material(fog).unwrap();
    environment
}

pub(super) fn put(environment: &mut Environment, object_from_mesh: DAffine3, loops: &[Loop]) {
    let pose = Pose::from_xyz_rpy(DVec3::new(3.0, -2.0, 1.0), 0.0, 0.0, 0.3);
    environment.insert(NewObject { object_from_mesh, ..NewObject::new("o", pose, mesh(loops)) }).unwrap();
}

fn of(loops: &[Loop]) -> Environment {
    let mut environment = empty();
    put(&mut environment, DAffine3::IDENTITY, loops);
    environment
}

/// Creases, borders, material borders, intersections, corners, vertical and horizontal patches, contours.
fn counts(environment: &Environment) -> [usize; 8] {
    let generated = generate(environment, "video", &GenerateOptions::default()).unwrap();
    let ids: Vec<u32> = generated.layer.features.iter().map(|f| f.id).collect();
    assert_eq!(ids, (1..=ids.len() as u32).collect::<Vec<_>>());
    generated.counts.made
}

/// 12 edges, 8 corners, 4 walls, top and bottom.
const BOX: [usize; 8] = [12, 0, 0, 0, 8, 4, 2, 0];

fn reversed(l: &Loop) -> Loop {
    (l.0.iter().rev().copied().collect(), l.1)
}

#[test]
fn windings_and_doubled_faces_change_nothing() {
    let faces = cuboid(Vec3::ZERO, Vec3::ONE);
    assert_eq!(counts(&of(&faces)), BOX);
    let mixed: Vec<Loop> =
        faces.iter().enumerate().map(|(k, f)| if k % 2 == 0 { reversed(f) } else { f.clone() }).collect();
    assert_eq!(counts(&of(&mixed)), BOX);
    let twice: Vec<Loop> = faces.iter().flat_map(|f| [f.clone(), reversed(f)]).collect();
    assert_eq!(counts(&of(&twice)), BOX);
    let same: Vec<Loop> = faces.iter().flat_map(|f| [f.clone(), f.clone()]).collect();
    assert_eq!(counts(&of(&same)), BOX);
    // Cut along a diagonal: the diagonal is not an edge.
    let halves: Vec<Loop> =
        faces.iter().flat_map(|(c, m)| [(vec![c[0], c[1], c[2]], *m), (vec![c[2], c[3], c[0]], *m)]).collect();
    assert_eq!(counts(&of(&halves)), BOX);
}

#[test]
fn rims_of_a_cylinder_are_edges_and_its_facets_are_not() {
    // 48 facets turn by 7.5 degrees each; a rim's side is 0.13 m long, and no two are collinear.
    let at = |k: usize, z: f32| {
        let angle = std::f32::consts::TAU * (k % 48) as f32 / 48.0;
        Vec3::new(angle.cos(), angle.sin(), z)
    };
    let mut loops: Vec<Loop> =
        (0..48).map(|k| (vec![at(k, 0.0), at(k + 1, 0.0), at(k + 1, 2.0), at(k, 2.0)], 0)).collect();
    // The lateral surface alone: its rims are borders. A facet has 0.26 m^2.
    assert_eq!(counts(&of(&loops)), [0, 96, 0, 0, 0, 48, 0, 1]);
    loops.push(((0..48).map(|k| at(k, 2.0)).collect(), 0));
    loops.push(((0..48).rev().map(|k| at(k, 0.0)).collect(), 0));
    assert_eq!(counts(&of(&loops)), [96, 0, 0, 0, 0, 48, 2, 1]);
}

#[test]
fn t_junctions_are_not_borders() {
    // One long tile next to two short ones: the outline has four sides and four corners, and is one patch.
    let tiles = [
        rectangle([0.0, 2.0], [0.0, 1.0], 0.0, 0),
        rectangle([0.0, 0.7], [1.0, 2.0], 0.0, 0),
        rectangle([0.7, 2.0], [1.0, 2.0], 0.0, 0),
    ];
    assert_eq!(counts(&of(&tiles)), [0, 4, 0, 0, 4, 0, 1, 0]);
    // With the short ones folded up: one crease, six more sides, six corners, two patches.
    let up = |x: [f32; 2]| {
        (
            vec![
                Vec3::new(x[0], 1.0, 0.0),
                Vec3::new(x[1], 1.0, 0.0),
                Vec3::new(x[1], 1.0, 1.0),
                Vec3::new(x[0], 1.0, 1.0),
            ],
            0,
        )
    };
    assert_eq!(counts(&of(&[tiles[0].clone(), up([0.0, 0.7]), up([0.7, 2.0])])), [1, 6, 0, 0, 6, 1, 1, 0]);
    // With one of them shorter the rest of the long side is a border. Sides of the fold: 0.7 crease and 1.3 border are
    // collinear and make one edge; the fold has three more sides, the tile three.
    let short = generate(&of(&[tiles[0].clone(), up([0.0, 0.7])]), "video", &GenerateOptions::default()).unwrap();
    assert_eq!(short.counts.of(FeatureKind::Crease) + short.counts.of(FeatureKind::Border), 7);
}

#[test]
fn materials_end_in_borders_and_invisible_ones_are_ignored() {
    let tiles = |other| [rectangle([0.0, 1.0], [0.0, 1.0], 0.0, 0), rectangle([1.0, 2.0], [0.0, 1.0], 0.0, other)];
    assert_eq!(counts(&of(&tiles(0))), [0, 4, 0, 0, 4, 0, 1, 0]);
    // The seam is an edge; where it meets the outline are two more corners.
    assert_eq!(counts(&of(&tiles(1)))[..5], [0, 4, 1, 0, 6]);
    // One tile remains.
    let fog = generate(&of(&tiles(2)), "video", &GenerateOptions::default()).unwrap();
    assert_eq!((fog.counts.made, fog.counts.invisible), ([0, 4, 0, 0, 4, 0, 1, 0], 1));
    assert_eq!(
        generate(&of(&tiles(2)), "radar", &GenerateOptions::default()).unwrap().counts.of(FeatureKind::Material),
        1
    );
}

#[test]
fn a_pillar_sunk_into_the_floor_shows_where_it_enters() {
    let mut environment = of(&[rectangle([-2.0, 2.0], [-2.0, 2.0], 0.0, 0)]);
    put(&mut environment, DAffine3::IDENTITY, &cuboid(Vec3::new(-0.2, -0.2, -1.0), Vec3::new(0.2, 0.2, 1.0)));
    // Floor: 4 borders, 4 corners. Pillar: 12 edges, 8 corners. Between them 4 lines, which meet in 4 corners. The
    // pillar's ends have 0.16 m^2.
    assert_eq!(counts(&environment), [12, 4, 0, 4, 16, 4, 1, 0]);
    let layer = generate(&environment, "video", &GenerateOptions::default()).unwrap().layer;
    let lines: Vec<_> = layer.features.iter().filter(|f| f.name.as_deref() == Some("intersection")).collect();
    for line in lines {
        // The line belongs to the smaller object, in its frame.
        assert_eq!(line.object.as_deref(), Some("o#2"));
        let [a, b] = line.shape.points() else { panic!("{line:?}") };
        assert!(a.z.abs() < 1e-9 && b.z.abs() < 1e-9 && (a.distance(*b) - 0.4).abs() < 1e-6, "{line:?}");
    }
}

#[test]
fn a_box_on_the_floor_keeps_its_lower_edges_and_flush_boxes_have_no_seam() {
    let unit = cuboid(Vec3::ZERO, Vec3::ONE);
    let mut standing = of(&[rectangle([-2.0, 2.0], [-2.0, 2.0], 0.0, 0)]);
    put(&mut standing, DAffine3::IDENTITY, &unit);
    assert_eq!(counts(&standing)[..5], [12, 4, 0, 0, 12]);
    // Side by side: each box loses the four sides around the seam; a mirrored box does, too. The four lines across the
    // seam continue in the other box and stay two lines each, because the boxes may move apart.
    for x in [1.0, -1.0] {
        let mut flush = of(&unit);
        let shift = DAffine3::from_translation(DVec3::X * if x < 0.0 { 2.0 } else { 1.0 });
        put(&mut flush, shift * DAffine3::from_scale(DVec3::new(x, 1.0, 1.0)), &unit);
        assert_eq!(counts(&flush)[..5], [16, 0, 0, 0, 8], "{x}");
        // A gap of a centimetre brings the sides back.
        let mut apart = of(&unit);
        let gap = DAffine3::from_translation(DVec3::X * 0.01);
        put(&mut apart, gap * shift * DAffine3::from_scale(DVec3::new(x, 1.0, 1.0)), &unit);
        assert_eq!(counts(&apart)[..5], [24, 0, 0, 0, 16], "{x}");
    }
}

#[test]
fn geometry_inside_solids_is_left_out() {
    let mut environment = of(&cuboid(Vec3::ZERO, Vec3::ONE));
    put(&mut environment, DAffine3::IDENTITY, &cuboid(Vec3::splat(0.3), Vec3::splat(0.7)));
    let generated = generate(&environment, "video", &GenerateOptions::default()).unwrap();
    assert_eq!((generated.counts.of(FeatureKind::Crease), generated.counts.buried), (12, 12));
    // Inside a room it is visible.
    let mut environment = of(&cuboid(Vec3::splat(-5.0), Vec3::splat(5.0)));
    put(&mut environment, DAffine3::IDENTITY, &cuboid(Vec3::splat(0.3), Vec3::splat(0.7)));
    assert_eq!(counts(&environment)[0], 24);
}

#[test]
fn features_are_in_the_frame_of_their_object_after_scale_and_mirror() {
    for scale in [DVec3::splat(100.0), DVec3::new(-100.0, 50.0, 200.0)] {
        let mut environment = empty();
        put(&mut environment, DAffine3::from_scale(scale), &cuboid(Vec3::ZERO, Vec3::splat(0.01)));
        assert_eq!(counts(&environment), BOX);
        let layer = generate(&environment, "video", &GenerateOptions::default()).unwrap().layer;
        let far = (scale * f64::from(0.01f32)).abs();
        for p in layer.features.iter().flat_map(|f| f.shape.points()) {
            assert!((p.abs().min((p.abs() - far).abs())).max_element() < 1e-9, "{p}");
        }
    }
    // A gentle ridge of 20 degrees becomes steep if stretched in height.
    let ridge = |h: f32| {
        let at = |x: f32, y: f32| Vec3::new(x, y, if x == 0.0 { h } else { 0.0 });
        [
            (vec![at(-1.0, 0.0), at(0.0, 0.0), at(0.0, 1.0), at(-1.0, 1.0)], 0),
            (vec![at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)], 0),
        ]
    };
    let height = 10f32.to_radians().tan();
    assert_eq!(counts(&of(&ridge(height)))[..2], [0, 6]);
    let mut steep = empty();
    put(&mut steep, DAffine3::from_scale(DVec3::new(1.0, 1.0, 3.0)), &ridge(height));
    assert_eq!(counts(&steep)[..2], [1, 6]);
}

/// Joined patches must still lie on their polygons, or placing the layer would refuse them.
#[test]
fn patches_are_not_joined_over_a_notch() {
    let plate = |corners: &[[f32; 2]]| -> Loop { (corners.iter().map(|c| Vec3::new(c[0], c[1], 0.0)).collect(), 0) };
    let left = || plate(&[[0.0, 0.0], [10.0, 0.0], [10.0, 1.0], [0.0, 1.0]]);
    // The corner at the seam is cut off by `cut`: the hull of both has hardly more area than they have.
    let right = |cut: f32| plate(&[[10.0 + cut, 0.0], [20.0, 0.0], [20.0, 1.0], [10.0, 1.0], [10.0, cut]]);
    let patches = |cut: f32| {
        let environment = of(&[left(), right(cut)]);
        let generated = generate(&environment, "video", &GenerateOptions::default()).unwrap();
        let placed = presight_features::place(&presight_model::world::World::new(environment), &generated.layer);
        assert!(placed.is_ok(), "cut by {cut}: {}", placed.unwrap_err());
        (generated.counts.of(FeatureKind::Horizontal), generated.counts.off)
    };
    assert_eq!(patches(1e-4), (1, 0));
    assert_eq!(patches(0.012), (2, 0));
}

#[test]
fn options_are_checked_and_kinds_are_respected() {
    let environment = of(&cuboid(Vec3::ZERO, Vec3::ONE));
    let default = GenerateOptions::default;
    for wrong in [
        GenerateOptions { min_length: f64::NAN, ..default() },
        GenerateOptions { crease: 0.0, ..default() },
        GenerateOptions { sigma: -1.0, ..default() },
    ] {
        assert_eq!(
            generate(&environment, "video", &wrong).unwrap_err().kind(),
            presight_model::error::ErrorKind::Usage
        );
    }
    let nameless = generate(&environment, "", &default()).unwrap_err();
    assert_eq!(nameless.kind(), presight_model::error::ErrorKind::Usage);
    // Angles in degrees, as users give them.
    let steep = GenerateOptions { crease: 200f64.to_radians(), ..default() };
    assert!(steep.check().unwrap_err().to_string().contains("200 degrees is out of its range"));
    for kind in FeatureKind::ALL {
        let only = generate(&environment, "video", &GenerateOptions { kinds: vec![kind], ..default() }).unwrap();
        assert_eq!(only.counts.of(kind), BOX[kind as usize], "{kind:?}");
        assert_eq!(only.layer.features.len(), BOX[kind as usize]);
        assert_eq!(kind.name().parse::<FeatureKind>().unwrap(), kind);
    }
    assert_eq!(
        generate(&environment, "video", &GenerateOptions { min_length: 1.1, ..default() })
            .unwrap()
            .counts
            .of(FeatureKind::Crease),
        0
    );
}
