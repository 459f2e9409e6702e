//! The paper's Fig. 10: a robot uncertain in x, y and heading looks for a vertical line. Prints how wide the region of
//! interest is at several distances, and draws it over lines seen from 150 drawn poses:
//! `cargo run --example region_of_interest -- region_of_interest.svg`.
#![expect(clippy::print_stdout, reason = "an example prints")]

use glam::{DMat3, DVec3};
use plotters::prelude::*;
use presight::Pose;
use presight::environment::FeatureShape;
use presight::features::roi::{BodyPoint, FeatureErrorModel, Projection, Roi, roi};
use std::f64::consts::TAU;

type Failure = Box<dyn std::error::Error>;

/// A pinhole camera of 640 x 480 pixels, body axes: x forward, y left, z up.
struct Camera;

const FOCAL: f64 = 500.0;

impl Projection for Camera {
    fn project(&self, p: DVec3) -> Option<[f64; 2]> {
        (p.x > 0.0).then(|| [319.5 - FOCAL * p.y / p.x, 239.5 - FOCAL * p.z / p.x])
    }

    fn lever(&self, p: DVec3) -> f64 {
        p.x
    }

    fn size(&self) -> (u32, u32) {
        (640, 480)
    }

    fn turn(&self) -> Option<f64> {
        None
    }
}

/// Standard deviations of the robot's x and y, metres, of its heading, radians, and of the line, metres.
const SIGMAS: [f64; 3] = [0.03, 0.017_453_292_519_943_295, 0.01];

fn line(distance: f64) -> (FeatureShape, [BodyPoint; 2]) {
    let ends = [DVec3::new(distance, 0.0, -0.6), DVec3::new(distance, 0.0, 0.6)];
    let covariances = [DMat3::from_diagonal(DVec3::splat(SIGMAS[2] * SIGMAS[2])); 2];
    let points = [0.0, 1.0].map(|t| BodyPoint::on_segment(&ends, t));
    (FeatureShape::Segment { ends, covariances, cross: DMat3::ZERO }, points)
}

fn uncertain(shape: &FeatureShape) -> FeatureErrorModel {
    let robot = presight::geometry::PoseCovariance::from_sigmas([SIGMAS[0], SIGMAS[0], 0.0, 0.0, 0.0, SIGMAS[1]]);
    FeatureErrorModel::new(&Pose::IDENTITY, &robot, &Pose::IDENTITY, None, shape).expect("sound poses")
}

fn region(distance: f64, confidence: f64) -> Option<Roi> {
    let (shape, points) = line(distance);
    roi(&Camera, &uncertain(&shape), &points, confidence)
}

fn main() -> Result<(), Failure> {
    println!("| distance | sigma of the column by hand | width of the region at 0.9 | 0.99 | 0.999 | height at 0.99 |");
    println!("|---|---|---|---|---|---|");
    for distance in [1.0, 2.0, 4.0, 8.0, 16.0] {
        // Sideways errors by the distance, heading as it is.
        let by_hand =
            FOCAL * ((SIGMAS[0].powi(2) + SIGMAS[2].powi(2)) / (distance * distance) + SIGMAS[1].powi(2)).sqrt();
        let all = [0.9, 0.99, 0.999].map(|confidence| region(distance, confidence).map_or([0.0; 4], |r| r.bounds));
        let [a, b, c] = all.map(|b| b[2] - b[0]);
        println!("| {distance} m | {by_hand:.1} px | {a:.1} px | {b:.1} | {c:.1} | {:.1} px |", all[1][3] - all[1][1]);
    }
    match std::env::args().nth(1) {
        Some(path) => draw(&path),
        None => Ok(()),
    }
}

fn draw(path: &str) -> Result<(), Failure> {
    let area = SVGBackend::new(path, (960, 260)).into_drawing_area();
    area.fill(&WHITE)?;
    for (distance, panel) in [2.0, 4.0, 8.0].into_iter().zip(area.split_evenly((1, 3))) {
        let mut chart = ChartBuilder::on(&panel)
            .caption(format!("a line {distance} m ahead"), ("sans-serif", 16))
            .margin(6)
            .x_label_area_size(22)
            .y_label_area_size(34)
            .build_cartesian_2d(219.5..419.5, 479.5..-0.5)?;
        chart.configure_mesh().disable_mesh().x_labels(4).y_labels(4).draw()?;
        let (shape, points) = line(distance);
        let uncertain = uncertain(&shape);
        let mut unit = uniform(7);
        for _ in 0..150 {
            let mut normal = || (-2.0 * unit().max(1e-300).ln()).sqrt() * (TAU * unit()).cos();
            let xi: Vec<f64> = (0..uncertain.dimensions()).map(|_| normal()).collect();
            let seen = points.iter().filter_map(|p| Camera.project(uncertain.place(p, &xi))).map(|[u, v]| (u, v));
            chart.draw_series(LineSeries::new(seen, RGBColor(86, 180, 233).mix(0.5)))?;
        }
        let nominal = points.iter().filter_map(|p| Camera.project(uncertain.place(p, &[]))).map(|[u, v]| (u, v));
        chart.draw_series(LineSeries::new(nominal, BLACK.stroke_width(2)))?;
        for confidence in [0.9, 0.99, 0.999] {
            let Some(Roi { bounds: [x0, y0, x1, y1], .. }) = region(distance, confidence) else { continue };
            let outline = [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)];
            chart.draw_series(LineSeries::new(outline, RGBColor(213, 94, 0)))?;
        }
    }
    area.present()?;
    Ok(())
}

/// Numbers in 0..1.
fn uniform(mut state: u64) -> impl FnMut() -> f64 {
    move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    }
}
