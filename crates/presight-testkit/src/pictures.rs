//! Pictures of failed comparisons: expected, actual and wrong pixels, as PNG files in `target/failed-images`.

use presight_pictures as png;
use presight_predict::virtual_sensors::Mask;
use presight_render::plan::{FramePlan, Images, Output};
use presight_render::verify::{PixelValues, Precision, Report, compare, compare_values};
use std::path::{Path, PathBuf};

/// As [`compare`]. If a pixel is wrong, also writes pictures and prints their folder.
///
/// # Panics
/// If the images have different shapes.
#[expect(clippy::print_stderr, reason = "where a failing test left its pictures is worth reading")]
pub fn compare_or_show(expected: &Images, actual: &Images, plan: &FramePlan, precision: Precision) -> Report {
    let report = compare(expected, actual, plan, precision).expect("images of one shape");
    if report.fault > 0 {
        let folder = folder_of_test(&plan.sensor.spec().name);
        match leave(&folder, expected, actual, plan, precision) {
            Ok(()) => eprintln!("expected.png, actual.png and difference.png: {}", folder.display()),
            Err(e) => eprintln!("no pictures of the wrong pixels: {e}"),
        }
    }
    report
}

/// Writes `expected.png`, `actual.png` and `difference.png` (wrong pixels white) into a folder.
///
/// # Errors
/// Write errors.
pub fn leave(
    folder: &Path,
    expected: &Images,
    actual: &Images,
    plan: &FramePlan,
    precision: Precision,
) -> presight_model::error::Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| {
        let kind = presight_model::error::ErrorKind::System;
        presight_model::error::Error::new(kind, format!("no folder for pictures: {e}"), "see the system's message")
            .in_file(folder)
    })?;
    let shown = expected.outputs().iter().next().unwrap_or(Output::Range);
    png::write_preview(&folder.join("expected.png"), expected, &plan.sensor, shown)?;
    png::write_preview(&folder.join("actual.png"), actual, &plan.sensor, shown)?;
    let mut mask = Mask { width: expected.width, height: expected.height, pixels: vec![false; expected.pixels()] };
    mark(expected, actual, plan, precision, 0, &mut mask.pixels);
    png::write_mask(&folder.join("difference.png"), &mask)
}

/// Marks the wrong pixels, starting at pixel `first`. Uses bisection, so that few pixels are compared more than once.
fn mark(expected: &Images, actual: &Images, plan: &FramePlan, precision: Precision, first: usize, wrong: &mut [bool]) {
    let width = expected.width as usize;
    let pixels = (first..first + wrong.len()).map(|at| {
        let place = ((at % width) as u32, (at / width) as u32);
        (place, PixelValues::of(expected, at), PixelValues::of(actual, at))
    });
    let fault = compare_values(pixels, plan, precision).fault;
    if fault == 0 || fault == wrong.len() {
        wrong.fill(fault > 0);
        return;
    }
    let half = wrong.len() / 2;
    let (left, right) = wrong.split_at_mut(half);
    mark(expected, actual, plan, precision, first, left);
    mark(expected, actual, plan, precision, first + half, right);
}

/// A separate folder for the running test and this sensor.
fn folder_of_test(sensor: &str) -> PathBuf {
    let target = std::env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../target"), PathBuf::from);
    let thread = std::thread::current();
    let plain = |text: &str| text.replace(|c: char| !c.is_ascii_alphanumeric() && c != '_', "-");
    let name = format!("{}-{}", plain(thread.name().unwrap_or("test")), plain(sensor));
    target.join("failed-images").join(name)
}
