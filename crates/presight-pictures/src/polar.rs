//! A scan of one row, seen from above: x forward is up, y left is left.

use super::canvas::{Canvas, FAINT, INK, PageRect, Rgb, TEXT_HEIGHT, mix, text_width};
use super::color::{MISS, Palette};
use super::overlay::Overlay;
use super::scale::{Scale, nice_step};
use super::top_view::draw_from_above;
use super::view::{HEADER, MARGIN, footer, page, title};
use glam::{DVec2, DVec3};
use presight_model::sensor::Sensor;
use presight_render::plan::{Images, Output};

/// Maximum side of the plan, pixels.
const SIDE: f64 = 960.0;
/// Free space between sensor and hit.
const FREE: Rgb = [0x39, 0x41, 0x4e];

/// From metres (x forward, y left) to page pixels.
pub struct Map {
    /// Page position of the sensor.
    pub origin: [f64; 2],
    pub pixels_per_metre: f64,
    pub size: [u32; 2],
}

impl Map {
    /// A map that shows all hits and the sensor.
    pub fn around(hits: &[Option<DVec2>]) -> Self {
        let seen = || hits.iter().flatten().copied();
        let (low, high) = seen().fold((DVec2::ZERO, DVec2::ZERO), |(lo, hi), p| (lo.min(p), hi.max(p)));
        let extent = (high - low).max_element().max(1e-3);
        let (low, high) = (low - 0.06 * extent, high + 0.06 * extent);
        let size = high - low;
        let pixels_per_metre = SIDE / size.max_element();
        // Never narrower than the legend needs.
        let across = (size.y * pixels_per_metre).max(0.65 * SIDE);
        let pad = (across - size.y * pixels_per_metre) / 2.0;
        let origin = [
            f64::from(MARGIN) + pad + high.y * pixels_per_metre,
            f64::from(MARGIN + HEADER) + high.x * pixels_per_metre,
        ];
        let size = [across.ceil() as u32, (size.x * pixels_per_metre).ceil().max(120.0) as u32];
        Self { origin, pixels_per_metre, size }
    }

    pub fn page(&self, p: DVec2) -> [f64; 2] {
        [self.origin[0] - p.y * self.pixels_per_metre, self.origin[1] - p.x * self.pixels_per_metre]
    }

    fn metres(&self, x: u32, y: u32) -> DVec2 {
        DVec2::new(self.origin[1] - f64::from(y), self.origin[0] - f64::from(x)) / self.pixels_per_metre
    }
}

/// Draws free space, range rings and hits in their colours.
pub fn draw(
    images: &Images,
    sensor: &Sensor,
    output: Output,
    palette: &Palette,
    scale: &Scale,
    overlay: Option<&Overlay<'_>>,
) -> Canvas {
    let horizontal = |column: u32| sensor.ray(column, 0).map(DVec3::truncate);
    let hits = hits(images, sensor);
    let map = Map::around(&hits);
    let mut canvas = page(map.size[0] + 2 * MARGIN, map.size[1], overlay);
    title(&mut canvas, sensor, output);
    canvas.fill(MARGIN, MARGIN + HEADER, map.size[0], map.size[1], MISS);
    free_space(&mut canvas, &map, &hits, horizontal);
    rings(&mut canvas, &map);
    for (i, hit) in hits.iter().enumerate() {
        let Some(point) = hit else { continue };
        let color = palette.color(i);
        // Neighbouring hits on one polygon are connected.
        let next = (i + 1 < hits.len()).then(|| hits[i + 1]).flatten();
        let same = images.polygon_id.get(i).is_some_and(|id| images.polygon_id.get(i + 1) == Some(id));
        if let Some(next) = next.filter(|_| same) {
            canvas.stroke(map.page(*point), map.page(next), 1.5, color);
        }
        canvas.disc(map.page(*point), 2.0, color);
    }
    if let Some(overlay) = overlay {
        let frame = PageRect { left: MARGIN, top: MARGIN + HEADER, width: map.size[0], height: map.size[1] };
        draw_from_above(overlay, &mut canvas, frame, &images.range, &|p| map.page(p));
    }
    marker(&mut canvas, &map);
    footer(&mut canvas, MARGIN + HEADER + map.size[1] + MARGIN, output, palette, scale);
    canvas
}

/// The hit of each ray of the row, metres (x forward, y left).
pub fn hits(images: &Images, sensor: &Sensor) -> Vec<Option<DVec2>> {
    let hit = |(column, range): (u32, &f32)| {
        let ray = sensor.ray(column, 0).filter(|_| range.is_finite())?;
        Some(ray.truncate() * f64::from(*range))
    };
    (0..).zip(&images.range).map(hit).collect()
}

/// Lightens the free space between the sensor and each hit.
pub fn free_space(canvas: &mut Canvas, map: &Map, hits: &[Option<DVec2>], ray: impl Fn(u32) -> Option<DVec2>) {
    let turn = std::f64::consts::TAU;
    let mut beams: Vec<(f64, f64)> = Vec::new();
    for (i, hit) in hits.iter().enumerate() {
        let Some(direction) = ray(i as u32) else { continue };
        let azimuth = direction.y.atan2(direction.x).rem_euclid(turn);
        beams.push((azimuth, hit.map_or(0.0, DVec2::length)));
    }
    beams.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some((first, last)) = beams.first().copied().zip(beams.last().copied()) else { return };
    let widest = 1.5 * (turn / beams.len() as f64);
    beams.insert(0, (last.0 - turn, last.1));
    beams.push((first.0 + turn, first.1));
    for y in MARGIN + HEADER..MARGIN + HEADER + map.size[1] {
        for x in MARGIN..MARGIN + map.size[0] {
            let p = map.metres(x, y);
            let azimuth = p.y.atan2(p.x).rem_euclid(turn);
            let after = beams.partition_point(|b| b.0 < azimuth).clamp(1, beams.len() - 1);
            let (a, b) = (beams[after - 1], beams[after]);
            let nearest = if azimuth - a.0 < b.0 - azimuth { a } else { b };
            if (nearest.0 - azimuth).abs() <= widest && p.length() < nearest.1 {
                canvas.set(x.into(), y.into(), FREE);
            }
        }
    }
}

/// Draws circles of equal distance, labelled in metres.
pub fn rings(canvas: &mut Canvas, map: &Map) {
    let reach = f64::from(map.size[0].max(map.size[1])) / map.pixels_per_metre;
    let (step, decimals) = nice_step(reach / 7.0);
    let inside = |x: i64, y: i64| {
        let (left, top) = (i64::from(MARGIN), i64::from(MARGIN + HEADER));
        (left..left + i64::from(map.size[0])).contains(&x) && (top..top + i64::from(map.size[1])).contains(&y)
    };
    for i in 1..=16 {
        let radius = f64::from(i) * step;
        let dots = (radius * map.pixels_per_metre * 6.3).ceil().clamp(8.0, 40_000.0) as u32;
        for k in 0..dots {
            let (sin, cos) = (f64::from(k) / f64::from(dots) * std::f64::consts::TAU).sin_cos();
            let [x, y] = map.page(radius * DVec2::new(cos, sin)).map(|v| v.round() as i64);
            if inside(x, y) {
                canvas.set(x, y, mix(canvas.get(x, y), FAINT, 0.4));
            }
        }
        let label = format!("{radius:.decimals$} m");
        // On the forward axis if there is room, otherwise to the right or left.
        let spots = [DVec2::new(radius, 0.0), DVec2::new(0.0, -radius), DVec2::new(0.0, radius)];
        let spot = spots.map(|p| map.page(p)).into_iter().find(|[x, y]| {
            let (x, y) = (*x as i64, *y as i64);
            inside(x + 4, y - 4 - i64::from(TEXT_HEIGHT)) && inside(x + 4 + i64::from(text_width(&label)), y)
        });
        if let Some([x, y]) = spot {
            canvas.text(x as u32 + 4, y as u32 - 4 - TEXT_HEIGHT, &label, FAINT);
        }
    }
}

/// Draws the sensor as an arrowhead that points forward.
pub fn marker(canvas: &mut Canvas, map: &Map) {
    let [x, y] = map.origin;
    let corners = [[x, y - 11.0], [x + 7.0, y + 8.0], [x, y + 4.0], [x - 7.0, y + 8.0]];
    for i in 0..4 {
        canvas.stroke(corners[i], corners[(i + 1) % 4], 1.0, INK);
    }
}
