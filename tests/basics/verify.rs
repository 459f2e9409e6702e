//! Checks the image comparison itself: it must find every planted fault and accept deviations within the bound.

#![allow(clippy::print_stderr)] // Prints skips and results.

use presight_testkit as common;

use common::{plan, reference, scenes};
use glam::DVec3;
use presight_model::environment::NewObject;
use presight_model::geometry::Pose;
use presight_model::world::World;
use presight_render::plan::{FramePlan, Images};
use presight_render::verify::{Precision, Report, allowed, compare, compare_exactly};
use std::sync::Arc;

fn frames() -> Vec<(FramePlan, Images)> {
    let world = scenes::room_world(3, 12);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 1.3), 0.02, 0.05, 0.7);
    [scenes::camera(97, 61), scenes::scanner(120, 31)]
        .iter()
        .map(|sensor| {
            let plan = plan(&world, sensor, &pose);
            let images = reference(&plan);
            (plan, images)
        })
        .collect()
}

/// Both comparisons must report faults.
fn caught(plan: &FramePlan, right: &Images, wrong: &Images) -> Report {
    for precision in [Precision::F64, Precision::F32] {
        let report = compare(right, wrong, plan, precision).unwrap();
        assert!(report.fault > 0 && report.check(1.0).is_err(), "{precision:?} lets it pass");
        assert!(!report.faults.is_empty() && report.faults[0].why.contains("would be right"));
    }
    let report = compare_exactly(right, wrong).unwrap();
    assert!(report.fault > 0);
    report
}

#[test]
fn equal_images_are_the_same() {
    for (plan, images) in frames() {
        let report = compare(&images, &images, &plan, Precision::F64).unwrap();
        assert_eq!((report.same, report.fault, report.edge), (images.pixels(), 0, 0));
        assert!(report.check(0.0).is_ok());
        assert_eq!(compare_exactly(&images, &images).unwrap().same, images.pixels());
    }
}

#[test]
fn one_pixel_is_caught() {
    for (plan, images) in frames() {
        let at = images.pixels() / 2 + 7;
        let mut wrong = images.clone();
        wrong.range[at] *= 1.001;
        assert_eq!(caught(&plan, &images, &wrong).fault, 1);
        let mut wrong = images.clone();
        wrong.polygon_id[at] += 1;
        assert_eq!(caught(&plan, &images, &wrong).fault, 1);
        let mut wrong = images.clone();
        wrong.object_id[at] += 1;
        assert_eq!(caught(&plan, &images, &wrong).fault, 1);
        let mut wrong = images.clone();
        (wrong.range[at], wrong.polygon_id[at], wrong.object_id[at]) = (f32::INFINITY, 0, 0);
        (wrong.cos_incidence[at], wrong.echo[at], wrong.normal[at]) = (f32::NAN, f32::NAN, [f32::NAN; 3]);
        if let Some(z) = wrong.depth_z.get_mut(at) {
            *z = f32::INFINITY;
        }
        assert_eq!(caught(&plan, &images, &wrong).fault, 1);
    }
}

/// The largest f32 that is at most `most` above `x`.
fn last_within(x: f32, most: f64) -> f32 {
    let mut y = (f64::from(x) + most) as f32;
    while f64::from(y) - f64::from(x) > most {
        y = y.next_down();
    }
    y
}

#[test]
fn one_ulp_within_the_bound_passes_and_one_beyond_is_caught() {
    for (plan, images) in frames() {
        for precision in [Precision::F64, Precision::F32] {
            for at in (0..images.pixels()).step_by(97) {
                let pixel = (at as u32 % images.width, at as u32 / images.width);
                let most = allowed(&images, &plan, pixel, precision).unwrap();
                let judge = |change: &dyn Fn(&mut Images)| {
                    let mut other = images.clone();
                    change(&mut other);
                    compare(&images, &other, &plan, precision).unwrap()
                };
                let within = last_within(images.range[at], most.range);
                assert!(within > images.range[at]);
                let report = judge(&|i| i.range[at] = within);
                assert_eq!((report.same, report.fault), (images.pixels(), 0));
                assert!(report.worst.range > 0.1 && report.worst.range <= 1.0);
                assert_eq!(judge(&|i| i.range[at] = within.next_up()).fault, 1);
                let within = last_within(images.cos_incidence[at], most.cos_incidence);
                assert_eq!(judge(&|i| i.cos_incidence[at] = within).fault, 0);
                assert_eq!(judge(&|i| i.cos_incidence[at] = within.next_up()).fault, 1);
                let within = last_within(images.echo[at], most.echo);
                assert_eq!(judge(&|i| i.echo[at] = within).fault, 0);
                assert_eq!(judge(&|i| i.echo[at] = within.next_up()).fault, 1);
                for axis in 0..3 {
                    let within = last_within(images.normal[at][axis], most.normal[axis]);
                    let report = judge(&|i| i.normal[at][axis] = within);
                    assert!(report.fault == 0 && report.worst.normal > 0.1 && report.worst.normal <= 1.0);
                    assert_eq!(judge(&|i| i.normal[at][axis] = within.next_up()).fault, 1);
                }
                if plan.sensor.is_camera() {
                    let within = last_within(images.depth_z[at], most.depth_z);
                    assert_eq!(judge(&|i| i.depth_z[at] = within).fault, 0);
                    assert_eq!(judge(&|i| i.depth_z[at] = within.next_up()).fault, 1);
                }
            }
        }
    }
}

#[test]
fn swapped_ids_are_caught() {
    for (plan, images) in frames() {
        let a = images.polygon_id[0];
        let b = *images.polygon_id.iter().find(|id| **id != a).unwrap();
        let mut wrong = images.clone();
        for id in &mut wrong.polygon_id {
            *id = if *id == a {
                b
            } else if *id == b {
                a
            } else {
                *id
            };
        }
        caught(&plan, &images, &wrong);
    }
}

#[test]
fn nothing_but_zeros_is_caught() {
    for (plan, images) in frames() {
        let mut wrong = Images::default();
        wrong.prepare(images.width, images.height, images.outputs());
        wrong.range.fill(0.0);
        wrong.polygon_id.fill(0);
        assert_eq!(caught(&plan, &images, &wrong).fault, images.pixels());
    }
}

fn shifted<T: Copy>(image: &[T], width: usize) -> Vec<T> {
    let row = |r: &[T]| r.iter().skip(1).chain(r.last()).copied().collect::<Vec<T>>();
    image.chunks(width).flat_map(row).collect()
}

#[test]
fn an_image_shifted_by_one_pixel_is_caught() {
    for (plan, images) in frames() {
        let w = images.width as usize;
        let wrong = Images {
            range: shifted(&images.range, w),
            depth_z: shifted(&images.depth_z, w),
            polygon_id: shifted(&images.polygon_id, w),
            object_id: shifted(&images.object_id, w),
            cos_incidence: shifted(&images.cos_incidence, w),
            echo: shifted(&images.echo, w),
            normal: shifted(&images.normal, w),
            ..images.clone()
        };
        caught(&plan, &images, &wrong);
        // With ids alone, too: range is right everywhere then.
        let ids_only = Images { polygon_id: shifted(&images.polygon_id, w), ..images.clone() };
        caught(&plan, &images, &ids_only);
    }
}

/// The polygon mirrored through the sensor is in the opposite cone at the same ranges.
#[test]
fn a_polygon_painted_in_the_opposite_direction_is_caught() {
    let at = DVec3::new(0.1, 0.2, 1.3);
    let quad = [[2.0, -0.3, 1.0], [2.0, 0.3, 1.0], [2.0, 0.3, 1.6], [2.0, -0.3, 1.6]].map(glam::Vec3::from);
    let through = quad.map(|p| (2.0 * at - p.as_dvec3()).as_vec3());
    let world = |corners: [glam::Vec3; 4]| {
        let mut environment = scenes::room(3, 12);
        let mesh = Arc::new(scenes::mesh(&[corners.to_vec()]));
        environment.insert(NewObject::new("poster", Pose::IDENTITY, mesh)).unwrap();
        World::new(environment)
    };
    let pose = Pose::from_xyz_rpy(at, 0.0, 0.0, 0.1);
    let sensor = scenes::scanner(120, 31);
    let right = plan(&world(quad), &sensor, &pose);
    let wrong = plan(&world(through), &sensor, &pose);
    caught(&right, &reference(&right), &reference(&wrong));
}

#[test]
fn nan_and_infinity_are_caught() {
    for (plan, images) in frames() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, -1.0] {
            let mut wrong = images.clone();
            wrong.range[11] = bad;
            assert_eq!(caught(&plan, &images, &wrong).fault, 1);
            let mut wrong = images.clone();
            wrong.cos_incidence[12] = bad;
            assert_eq!(caught(&plan, &images, &wrong).fault, 1);
            let mut wrong = images.clone();
            wrong.echo[13] = bad;
            assert_eq!(caught(&plan, &images, &wrong).fault, 1);
            // The normal of the other side, in place of a component within the bound.
            let mut wrong = images.clone();
            wrong.normal[14] = if bad.abs() <= 1.0 { wrong.normal[14].map(|x| -x) } else { [bad, 0.0, 0.0] };
            assert_eq!(caught(&plan, &images, &wrong).fault, 1);
        }
    }
}

#[test]
fn other_sizes_and_outputs_are_refused() {
    for (plan, images) in frames() {
        let mut truncated = images.clone();
        truncated.range.pop();
        let mut fewer = images.clone();
        fewer.cos_incidence.clear();
        let turned = Images { width: images.height, height: images.width, ..images.clone() };
        for wrong in [truncated, fewer, turned] {
            assert!(compare(&images, &wrong, &plan, Precision::F64).is_err());
            assert!(compare(&wrong, &images, &plan, Precision::F64).is_err());
            assert!(compare_exactly(&images, &wrong).is_err());
        }
    }
}
