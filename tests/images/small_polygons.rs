//! A hall of small triangles, most of them behind others or between the rays: the CPU engine skips those, and its
//! images equal the reference.

use presight_testkit as common;

use common::hall::{hall_poses, open_hall};
use common::{engines, plan, reference, scenes};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_render::cpu::CpuEngine;
use presight_render::plan::CountName;
use presight_render::plan::{Images, Stats};
use presight_render::verify::{Precision, compare};

fn sensors() -> Vec<Sensor> {
    let [camera, scanner] = [scenes::camera(161, 121), scenes::scanner(360, 61)];
    vec![camera, scanner, scenes::scanner(3600, 1), scenes::lens(121, 91), scenes::fisheye(91, 91)]
}

#[test]
fn images_of_small_polygons_equal_the_reference() {
    let hall = open_hall(3, 60_000);
    let poses = hall_poses(&hall, 5, 2);
    let world = World::new(hall);
    let mut left_out = 0;
    for threads in [1, 2] {
        let mut engine = CpuEngine::new(threads).expect("threads");
        let mut tiles = engines::cpu_by_tiles(threads);
        for (pose, sensor) in poses.iter().flat_map(|pose| sensors().into_iter().map(move |sensor| (pose, sensor))) {
            let plan = plan(&world, &sensor, pose);
            let (mut images, mut stats) = (Images::default(), Stats::default());
            engine.render(&plan, &mut images, &mut stats).expect("the engine renders");
            let (expected, name) = (reference(&plan), &sensor.spec().name);
            for images in [&images, &tiles(&plan)] {
                let report = compare(&expected, images, &plan, Precision::F64).expect("images of one shape");
                assert_eq!(report.fault, 0, "{name}: first {:#?}", report.faults.first());
                assert!(report.pixels > 0, "{name}");
            }
            let [placed, passed, between] =
                [CountName::PolygonsPlaced, CountName::PolygonsPassed, CountName::PolygonsBetweenSamples]
                    .map(|count| stats.count_of(count).unwrap_or(0));
            left_out += placed - passed + between;
        }
    }
    assert!(left_out > 1000, "{left_out} between samples");
}
