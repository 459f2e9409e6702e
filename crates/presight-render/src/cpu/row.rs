//! Rows of level scanners: a search in the plane finds which polygon each beam meets ([`crate::row`]), and images are made of
//! its plane by the arithmetic of setup and rasterization. Where rounding could decide, the candidates are drawn as usual.

use super::batch::{Shade, Winners};
use super::lanes::PolygonLanes;
use super::raster_lines::{Buffer, EIGHT};
use super::resolve::{self, Target};
use super::setup::RayInstance;
use super::{Bands, CpuEngine};
use crate::plan::{CountName, FramePlan, Images, StageName, Stats};
use crate::row::{NOTHING, RowBeams, RowCut, RowSearch, RowView, Search, UNSURE};
use glam::DVec3;
use presight_model::clock::Instant;
use presight_model::error::{Error, Result};
use presight_model::sensor::{LineAxis, LineGrid, PixelGrid};

/// Scratch memory for rows.
#[derive(Default)]
pub(super) struct RowDrawer {
    /// Of the last sensor.
    beams: Option<RowBeams>,
    search: RowSearch,
    lanes: Option<Box<PolygonLanes>>,
    winners: Winners,
    /// By winner: inverse depth of a ray s is m . s.
    planes: Vec<DVec3>,
    /// By segment of the cut: its number among the winners, or 0.
    numbers: Vec<u32>,
    /// Winners by object and polygon, with their segments.
    seen: Vec<(u64, u32)>,
    buffer: Buffer,
}

impl CpuEngine {
    /// Fills the asked images of a level scanner of one row, on the calling thread.
    pub(super) fn draw_row(
        &mut self,
        plan: &FramePlan,
        cut: &RowCut,
        images: &mut Images,
        stats: &mut Stats,
    ) -> Result<()> {
        let start = Instant::now();
        plan.world_from_sensor.check()?;
        images.try_prepare(plan.sensor.width(), plan.sensor.height(), plan.drawn())?;
        (stats.engine, stats.threads) = ("row", 1);
        let mut row = std::mem::take(&mut self.row);
        row.find(plan, cut)?;
        let lines = plan.sensor.width() as usize;
        let bands =
            Bands { axis: LineAxis::Columns, lines, samples: 1, per_band: lines.next_multiple_of(resolve::TOGETHER) };
        row.buffer.reserve(bands.axis, lines, 1)?;
        for target in &mut resolve::split(images, &bands) {
            pulp::Arch::new().dispatch(DrawRow { row: &mut row, plan, cut, bands: &bands, target });
        }
        if !row.search.candidates.is_empty() {
            self.decide(plan, cut, &row.search, images)?;
        }
        stats.stages_ms.push((StageName::Rasterization, start.elapsed().as_secs_f64() * 1e3));
        stats.count(CountName::SegmentsOfCut, cut.segments.len());
        stats.count(CountName::SegmentsTested, row.search.tested);
        stats.count(CountName::BeamsDecided, row.search.winners.iter().filter(|w| **w == UNSURE).count());
        self.row = row;
        plan.finish_noting(images, stats)
    }

    /// Draws the candidates, and takes over the beams that are not sure.
    fn decide(&mut self, plan: &FramePlan, cut: &RowCut, search: &RowSearch, images: &mut Images) -> Result<()> {
        let candidates = search.candidates.iter().flat_map(|s| cut.with_copies(*s));
        let mut polygons: Vec<(u32, u32)> = candidates.map(|s| (s.object, s.polygon)).collect();
        polygons.sort_unstable();
        polygons.dedup();
        let mut drawn = std::mem::take(&mut self.part);
        self.draw(&plan.of_polygons(&polygons), &mut drawn, &mut Stats::default())?;
        for i in (0..search.winners.len()).filter(|i| search.winners[*i] == UNSURE) {
            fn take<T: Copy>(to: &mut [T], from: &[T], i: usize) {
                to.get_mut(i).into_iter().zip(from.get(i)).for_each(|(to, from)| *to = *from);
            }
            take(&mut images.range, &drawn.range, i);
            take(&mut images.cos_incidence, &drawn.cos_incidence, i);
            take(&mut images.polygon_id, &drawn.polygon_id, i);
            take(&mut images.object_id, &drawn.object_id, i);
        }
        self.part = drawn;
        Ok(())
    }
}

impl RowDrawer {
    /// Finds the segment of each beam.
    fn find(&mut self, plan: &FramePlan, cut: &RowCut) -> Result<()> {
        if !self.beams.as_ref().is_some_and(|beams| beams.are_of(&plan.sensor)) {
            self.beams = RowBeams::new(&plan.sensor);
        }
        let Some(beams) = &self.beams else {
            return Err(Error::usage(
                "a cut of the world for a sensor that is no scanner of one row",
                "predict without it",
            ));
        };
        let view = RowView::new(&plan.world_from_sensor, plan.sensor.spec().range_max);
        pulp::Arch::new().dispatch(Search { search: &mut self.search, beams, cut, view });
        Ok(())
    }

    /// Numbers the winners, and works out their planes as setup does.
    #[inline(always)]
    fn set_up(&mut self, plan: &FramePlan, cut: &RowCut) {
        let Self { search, lanes, winners, planes, numbers, seen, .. } = self;
        numbers.resize(cut.segments.len().max(numbers.len()), 0);
        seen.clear();
        for &segment in search.winners.iter().filter(|w| **w < UNSURE) {
            if std::mem::replace(&mut numbers[segment as usize], 1) == 0 {
                let of = &cut.segments[segment as usize];
                seen.push((u64::from(of.object) << 32 | u64::from(of.polygon), segment));
            }
        }
        seen.sort_unstable();
        winners.clear();
        planes.clear();
        planes.push(DVec3::ZERO);
        let lanes = lanes.get_or_insert_with(|| Box::new(PolygonLanes::new()));
        for of_object in seen.chunk_by(|a, b| a.0 >> 32 == b.0 >> 32) {
            let object = (of_object[0].0 >> 32) as u32;
            let instance = plan.instance_of(object);
            let at = RayInstance::new(plan, &instance);
            for eight in of_object.chunks(EIGHT) {
                let mut polygons = [0; EIGHT];
                polygons.iter_mut().zip(eight).for_each(|(polygon, of)| *polygon = of.0 as u32);
                let polygons = &polygons[..eight.len()];
                lanes.load(&at, polygons, None);
                lanes.measure(&at, polygons);
                lanes.set_depths(&at);
                for (i, (polygon, (_, segment))) in polygons.iter().zip(eight).enumerate() {
                    if cut.has_copies(*segment) && !has_one_nearest(&at, *polygon) {
                        search.candidates.push(*segment);
                        search.winners.iter_mut().filter(|w| **w == *segment).for_each(|w| *w = UNSURE);
                    }
                    debug_assert!(!lanes.edge_on[i], "{polygon} of {object} is edge-on");
                    let normal = at.mesh.planes()[*polygon as usize].normal;
                    numbers[*segment as usize] = planes.len() as u32;
                    planes.push(DVec3::new(lanes.m[0][i], lanes.m[1][i], lanes.m[2][i]));
                    winners.shades.push(Shade {
                        distance: lanes.distance[i].abs() * at.length_per_distance(normal),
                        polygon_id: plan.drawn_polygon_id(object, *polygon),
                        object_id: object + 1,
                    });
                }
            }
        }
    }

    /// Fills the z-buffer as the rasterizer does.
    #[inline(always)]
    fn fill(&mut self, grid: &LineGrid) {
        let Self { search, planes, numbers, buffer, .. } = self;
        buffer.clear(LineAxis::Columns, search.winners.len(), 1);
        let [w0, w1] = grid.weights()[0];
        for (line, (segment, [c0, c1])) in search.winners.iter().zip(grid.lines()).enumerate() {
            if *segment < UNSURE {
                let number = numbers[*segment as usize];
                let m = planes[number as usize];
                let scale = m.x * c0 + m.y * c1;
                let (at, i) = buffer.place(line, 0);
                (buffer.inverse[at].0[i], buffer.winner[at].0[i]) = (scale * w0 + m.z * w1, number.into());
            }
        }
    }
}

/// True if no two corners are equally near: then planes of coincident faces are measured at the same one.
fn has_one_nearest(at: &RayInstance<'_>, polygon: u32) -> bool {
    let squares = || at.mesh.corners_of(polygon).map(|p| (p - at.center).length_squared());
    let least = squares().fold(f64::INFINITY, f64::min);
    squares().filter(|square| *square <= least * (1.0 + 1e-14)).count() == 1
}

/// Draws the beams that are sure, and nothing for others.
struct DrawRow<'a, 't> {
    row: &'a mut RowDrawer,
    plan: &'a FramePlan,
    cut: &'a RowCut,
    bands: &'a Bands,
    target: &'a mut Target<'t>,
}

impl pulp::WithSimd for DrawRow<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self { row, plan, cut, bands, target } = self;
        row.set_up(plan, cut);
        if let PixelGrid::Lines(grid) = plan.sensor.grid() {
            row.fill(grid);
        }
        resolve::resolve(target, &row.buffer, plan, &row.winners.shades, bands, 0, f32::INFINITY);
        row.seen.iter().for_each(|(_, segment)| row.numbers[*segment as usize] = 0);
    }
}

const _: () = assert!(NOTHING > UNSURE);
