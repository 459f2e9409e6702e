//! The echo image: reflection factor times cos_incidence, equal on every engine, and free unless requested.

#![allow(clippy::print_stderr, reason = "the tests print their comparisons")]

use presight_testkit as common;

use common::{engines, reference, scenes, summary};
use glam::{DVec3, Vec3};
use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::request::Request;
use presight_render::plan::{FramePlan, IdScheme, Images, Output, Outputs};
use presight_render::verify::compare;

/// Reflection factors by material; none is a power of two, so that every product is rounded.
const FACTORS: [f64; 4] = [0.9, 0.3, 0.07, 0.0];

/// A room of six walls in four materials, with a box of one material in it. Polygons are ordered spatially and their
/// source numbers run backwards, so neither order is the other's.
fn world() -> World {
    let mut environment = Environment::new();
    for reflection in FACTORS {
        environment.add_material(Material { reflection, ..Material::named(format!("{reflection}")) }).unwrap();
    }
    let shell = scenes::cuboid(Vec3::new(-3.0, -2.0, 0.0), Vec3::new(3.0, 2.0, 2.5));
    let polygons = (0..6).map(|i| Polygon {
        source: 5 - i,
        ..Polygon::new(shell.corner_indices(i).to_vec(), [0, 1, 2, 3, 0, 1][i as usize])
    });
    let mixed = Mesh::new("mixed", shell.vertices().to_vec(), polygons.collect(), PolygonOrder::Spatial).unwrap();
    environment.insert(NewObject::new("pad", Pose::IDENTITY, pad(2).into())).unwrap();
    environment.insert(NewObject { first_source: 7, ..NewObject::new("room", Pose::IDENTITY, mixed.into()) }).unwrap();
    World::new(environment)
}

/// A mat on the floor.
fn pad(material: u16) -> Mesh {
    let corners = [[0.5, -0.5, 0.01], [1.5, -0.5, 0.01], [1.5, 0.5, 0.01], [0.5, 0.5, 0.01]].map(Vec3::from);
    Mesh::new("pad", corners.to_vec(), vec![Polygon::new(vec![0, 1, 2, 3], material)], PolygonOrder::Given).unwrap()
}

fn pose() -> Pose {
    Pose::from_xyz_rpy(DVec3::new(-1.0, 0.1, 1.2), 0.02, 0.3, 0.1)
}

fn plan(world: &World, sensor: &Sensor, outputs: Outputs, ids: IdScheme) -> FramePlan {
    FramePlan::new(world, sensor, &pose(), &Request::of(outputs).with_ids(ids)).unwrap()
}

/// The echo by the materials, polygon by polygon, without the stage under test.
fn expected(world: &World, images: &Images, at: usize) -> f32 {
    let Some(slot) = images.polygon_id[at].checked_sub(1) else { return f32::NAN };
    let (object, polygon) = world.environment().locate(slot).unwrap();
    let material = world.environment().objects()[object as usize].mesh.material(polygon);
    (FACTORS[usize::from(material)] * f64::from(images.cos_incidence[at])) as f32
}

#[test]
fn the_echo_is_the_material_factor_times_the_cosine() {
    let world = world();
    for sensor in [scenes::camera(61, 47), scenes::scanner(72, 21), scenes::all_round(40, 21)] {
        let all = reference(&plan(&world, &sensor, Outputs::ALL, IdScheme::Model));
        let mut seen = [0; FACTORS.len()];
        for at in 0..all.pixels() {
            let want = expected(&world, &all, at);
            assert!(all.echo[at].to_bits() == want.to_bits() || all.echo[at].is_nan() && want.is_nan(), "pixel {at}");
            assert_eq!(all.echo[at].is_nan(), all.cos_incidence[at].is_nan());
            if let Some(i) = FACTORS.iter().position(|f| (f * f64::from(all.cos_incidence[at])) as f32 == want) {
                seen[i] += 1;
            }
        }
        assert!(seen.iter().filter(|n| **n > 10).count() >= 3, "the scene shows too little: {seen:?}");
        // The same for every id scheme and every set of outputs.
        for ids in [IdScheme::Model, IdScheme::Source] {
            let lone = reference(&plan(&world, &sensor, Outputs::of(&[Output::Echo]), ids));
            assert_eq!(lone.outputs(), Outputs::of(&[Output::Echo]));
            assert_eq!(bits(&lone.echo), bits(&all.echo));
        }
    }
}

fn bits(image: &[f32]) -> Vec<u32> {
    image.iter().map(|v| v.to_bits()).collect()
}

#[test]
fn engines_agree_and_a_planted_fault_is_caught() {
    let world = world();
    let mut engines = engines::all();
    for (_, precision, render) in &mut engines {
        for sensor in [scenes::camera(97, 61), scenes::scanner(120, 31), scenes::all_round(40, 21)] {
            for outputs in [Outputs::ALL, Outputs::of(&[Output::Echo])] {
                let outputs = if sensor.is_camera() { outputs } else { outputs.without(Output::DepthZ) };
                for ids in [IdScheme::Model, IdScheme::Source] {
                    let plan = plan(&world, &sensor, outputs, ids);
                    let (right, got) = (reference(&plan), render(&plan));
                    let report = common::compare_or_show(&right, &got, &plan, *precision);
                    eprintln!("{precision:?} {}: {}", sensor.spec().name, summary(&report));
                    report.check(0.01).unwrap();
                    // Planted fault: the neighbouring material's factor at one pixel.
                    let at = (0..got.pixels()).find(|i| got.echo[*i] > 0.1).unwrap();
                    let mut wrong = got.clone();
                    wrong.echo[at] *= 0.999;
                    assert_eq!(compare(&right, &wrong, &plan, *precision).unwrap().fault, 1);
                }
            }
        }
    }
}

#[test]
fn without_a_request_there_is_no_echo_and_no_cost() {
    let world = world();
    let sensor = scenes::camera(31, 23);
    let without = plan(&world, &sensor, Outputs::of(&[Output::Range]), IdScheme::Model);
    assert_eq!(without.drawn(), Outputs::of(&[Output::Range]));
    assert!(reference(&without).echo.is_empty());
    // With one factor for everything no stage needs the material.
    let plain = scenes::room_world(3, 4);
    let asked = FramePlan::new(&plain, &sensor, &Pose::IDENTITY, &Request::of(Outputs::of(&[Output::Echo]))).unwrap();
    assert_eq!(asked.drawn(), Outputs::of(&[Output::CosIncidence]));
    assert_eq!(asked.request.outputs, Outputs::of(&[Output::Echo]));
}
