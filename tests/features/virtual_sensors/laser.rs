//! Laser: depth images and vertical planes.

use super::*;
use presight_model::geometry::SensorPose;
use presight_predict::virtual_sensors::{DepthImage, VerticalPlanes};
use presight_render::points::{PointCloud, PointsFrame};

fn depth(world: &World, sensor: &Sensor, pose: &Pose) -> DepthImage {
    match answer(VirtualSensor::DepthImage, world, sensor, pose, &Settings::default()) {
        Answer::DepthImage(depth) => depth,
        other => panic!("{other:?}"),
    }
}

fn planes(world: &World, sensor: &Sensor, pose: &Pose) -> VerticalPlanes {
    match answer(VirtualSensor::VerticalPlanes, world, sensor, pose, &Settings::default()) {
        Answer::VerticalPlanes(planes) => planes,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_depth_image_is_the_point_cloud_in_the_robots_frame() {
    let room = scenes::room_world(4, 6);
    let mut spec = scanner("laser", uniform(-60.0, 4.0, 31), uniform(-55.0, 5.0, 13));
    (spec.range_min, spec.range_max) = (0.9, 4.0);
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.2, 0.1, 1.2), 0.02, 0.1, -0.5);
    let mount = spec.mount;
    let (sensor, pose) = (Sensor::new(spec).unwrap(), Pose::from_xyz_rpy(DVec3::new(0.3, 0.2, 1.2), 0.0, 0.0, 1.0));
    let found = depth(&room, &sensor, &pose);
    let images = predict(&room, &sensor, &pose).images;
    let cloud = PointCloud::new(&images, &sensor, &SensorPose::new(pose), PointsFrame::Sensor).unwrap();
    assert_eq!((found.width, found.height, found.points_robot.len()), (31, 13, cloud.positions().len()));
    let there = cloud.positions().iter().filter(|p| !p.is_nan()).count();
    assert!(found.points == there && there > 0 && there < found.points_robot.len(), "{there} points");
    let [low, high] = found.bounds_robot.unwrap();
    for (got, p) in found.points_robot.iter().zip(cloud.positions()) {
        assert_eq!(got.is_none(), p.is_nan());
        if let Some(got) = got {
            assert!(DVec3::from(*got).distance(mount.transform_point(*p)) < 1e-12);
            assert!((0..3).all(|k| low[k] <= got[k] && got[k] <= high[k]));
        }
    }
    let nothing = depth(&World::new(scenes::empty()), &sensor, &pose);
    assert_eq!((nothing.points, nothing.bounds_robot), (0, None));
}

#[test]
fn a_wall_has_the_size_of_the_image_on_it() {
    let wall = world(vec![("wall", quad([[3.0, -9.0, -9.0], [3.0, 9.0, -9.0], [3.0, 9.0, 9.0], [3.0, -9.0, 9.0]]))]);
    for (yaw, tolerance) in [(0.0, 2e-4), (0.6, 4e-4)] {
        let mut spec = camera("laser", 120, 80, 100.0);
        spec.mount = Pose::from_xyz_rpy(DVec3::new(0.1, 0.0, 0.7), 0.0, 0.0, yaw);
        // The robot looks along x; the sensor on it is rotated.
        let pose = Pose::from_xyz_rpy(DVec3::new(0.1, 0.0, 0.7), 0.0, 0.0, yaw);
        let found = planes(&wall, &Sensor::new(spec).unwrap(), &pose);
        assert_eq!((found.planes.len(), found.pixels), (1, 9600));
        let plane = &found.planes[0];
        assert!(DVec3::from(plane.normal_robot).distance(DVec3::NEG_X) < 1e-12);
        assert!((plane.distance - 2.9).abs() < 1e-12 && (plane.centre_robot[0] - 3.0).abs() < 1e-12);
        // Across: between the tangents of the border rays. Upward: a trapezium, (f / cos) wider far away.
        let side = |pixels: f64| 2.9 * (yaw + (pixels / 100.0f64).atan()).tan();
        let true_area: f64 = (0..2400)
            .map(|i| {
                let at = |i: f64| side(-60.0 + i / 20.0);
                let (y0, y1) = (at(f64::from(i)), at(f64::from(i) + 1.0));
                // The distance along the optical axis at the centre of the strip.
                let y = 0.5 * (y0 + y1);
                (y1 - y0) * 80.0 * (2.9 * yaw.cos() + y * yaw.sin()) / 100.0
            })
            .sum();
        let off = |area: f64| (area / true_area - 1.0).abs();
        assert!(off(plane.area.unwrap()) < tolerance, "{} instead of {true_area}", plane.area.unwrap());
        assert!(off(plane.area.unwrap() * 1.001) > tolerance);
        assert!((plane.extent[0] - (side(59.5) - side(-59.5))).abs() < 1e-9);
        assert_eq!((plane.object.as_str(), plane.pixel_bounds), ("wall", [0, 0, 119, 79]));
    }
}

#[test]
fn only_walls_of_a_room_are_planes() {
    let ramp = quad([[1.0, -0.5, 0.0], [1.0, 0.5, 0.0], [1.1, 0.5, 1.0], [1.1, -0.5, 1.0]]);
    let room = world(vec![("room", cuboid([-3.0, -2.0, 0.0], [4.0, 2.0, 2.5])), ("ramp", ramp)]);
    let sensor = Sensor::new(scanner("laser", uniform(-180.0, 1.0, 360), uniform(-40.0, 2.0, 41))).unwrap();
    let found = planes(&room, &sensor, &Pose::from_xyz_rpy(DVec3::Z, 0.0, 0.0, 0.3));
    // The ramp, at 5.7 degrees, is in front of one wall and does not split it: the wall is visible above.
    assert_eq!(found.planes.len(), 4, "over the seam, too");
    let mut distances: Vec<f64> = found.planes.iter().map(|p| p.distance).collect();
    distances.sort_by(f64::total_cmp);
    for (distance, want) in distances.iter().zip([2.0, 2.0, 3.0, 4.0]) {
        assert!((distance - want).abs() < 1e-12);
    }
    assert_eq!(found.pixels, found.planes.iter().map(|p| p.pixels).sum::<usize>());
    assert!(found.planes.windows(2).all(|w| w[0].pixels >= w[1].pixels));
    assert!(found.planes.iter().all(|p| p.extent[1] <= 2.5 + 1e-12 && p.object == "room"));
}

#[test]
fn connected_panels_in_one_plane_are_one_region() {
    let panel = |x: f32, y0: f32, y1: f32| quad([[x, y0, -1.0], [x, y1, -1.0], [x, y1, 1.0], [x, y0, 1.0]]);
    let sensor = Sensor::new(camera("laser", 60, 20, 30.0)).unwrap();
    let count = |objects| {
        let found = planes(&world(objects), &sensor, &Pose::IDENTITY);
        (found.planes.len(), found.planes[0].object.clone(), found.planes[0].pixels)
    };
    let whole = count(vec![("a", panel(2.0, -2.0, 0.5)), ("b", panel(2.0, 0.5, 2.0))]);
    assert_eq!((whole.0, whole.1.as_str()), (1, "a"));
    assert_eq!(count(vec![("a", panel(2.0, -2.0, 0.5)), ("b", panel(2.01, 0.5, 2.0))]).0, 2, "a step of 1 cm");
    // A post in front splits one plane into two regions.
    let post = panel(1.0, 0.1, 0.2);
    assert_eq!(count(vec![("wall", panel(2.0, -2.0, 2.0)), ("post", post)]).0, 3);
    // One row has no height.
    let row = Sensor::new(scanner("laser", uniform(-30.0, 0.5, 121), uniform(0.0, 0.0, 1))).unwrap();
    let found = planes(&world(vec![("wall", panel(2.0, -2.0, 2.0))]), &row, &Pose::IDENTITY);
    assert_eq!((found.planes.len(), found.planes[0].area, found.planes[0].extent[1]), (1, None, 0.0));
}
