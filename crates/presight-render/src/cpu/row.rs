//! Rows of level scanners. A search in the plane finds the polygon of each beam ([`crate::row`]), and its plane gives
//! the images by the arithmetic of setup and rasterization. Where rounding could decide, the candidates are drawn as
//! usual.

use super::batch::{Batch, Shade, Winners};
use super::bounds::LANES;
use super::instance;
use super::lanes::PolygonLanes;
use super::raster_lines::{self, Buffer};
use super::resolve::{self, Target};
use super::setup;
use super::{Bands, CpuEngine, Vectors};
use crate::deadline::DeadlineOutcome;
use crate::plan::{CountName, FramePlan, Images, StageName, Stats};
use crate::row::{CutObject, NOTHING, RowBeams, RowCut, RowSearch, RowView, Search, UNSURE};
use glam::{DMat3, DVec3, Vec3};
use presight_model::clock::Instant;
use presight_model::error::{Error, Result};
use presight_model::sensor::{LineAxis, LineGrid, PixelGrid};
use pulp::Simd;

/// Scratch memory for rows.
#[derive(Default)]
pub(super) struct RowDrawer {
    /// Beams of the last sensor.
    beams: Option<RowBeams>,
    search: RowSearch,
    lanes: Option<Box<PolygonLanes<LANES>>>,
    winners: Winners,
    /// By winner: inverse depth of a ray s is m . s.
    planes: Vec<DVec3>,
    /// By segment of the cut: its number among the winners, or 0.
    numbers: Vec<u32>,
    /// Winners by object and polygon, with their segment.
    seen: Vec<(u64, u32)>,
    /// Candidates, as pairs of object and polygon, and their setup.
    polygons: Vec<(u32, u32)>,
    batch: Batch,
    buffer: Buffer,
}

impl CpuEngine {
    /// Fills the requested images of a level scanner of one row, on the calling thread.
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
        row.find(plan, cut, self.vectors)?;
        let lines = plan.sensor.width() as usize;
        let bands =
            Bands { axis: LineAxis::Columns, lines, samples: 1, per_band: lines.next_multiple_of(resolve::TOGETHER) };
        row.buffer.reserve(bands.axis, lines, 1)?;
        for target in &mut resolve::split(images, &bands) {
            self.vectors.dispatch(DrawRow { row: &mut row, plan, cut, bands: &bands, target });
        }
        stats.stages_ms.push((StageName::Rasterization, start.elapsed().as_secs_f64() * 1e3));
        stats.count(CountName::SegmentsOfCut, cut.segments.len());
        stats.count(CountName::SegmentsTested, row.search.tested);
        stats.count(CountName::BeamsDecided, row.search.winners.iter().filter(|w| **w == UNSURE).count());
        self.row = row;
        stats.deadline = plan.limit.is_some().then(|| DeadlineOutcome::drawn(plan.elapsed(), None));
        plan.finish_noting(images, stats)
    }
}

impl RowDrawer {
    /// Finds the segment of each beam.
    fn find(&mut self, plan: &FramePlan, cut: &RowCut, vectors: Vectors) -> Result<()> {
        if !self.beams.as_ref().is_some_and(|beams| beams.are_of(&plan.sensor)) {
            self.beams = RowBeams::new(&plan.sensor);
        }
        let Some(beams) = &self.beams else {
            return Err(Error::usage("a cut of the world serves scanners of one row only", "predict without it"));
        };
        let view = RowView::new(&plan.world_from_sensor, plan.sensor.spec().range_max, cut.margin);
        vectors.dispatch(Search { search: &mut self.search, beams, cut, view });
        Ok(())
    }

    /// Numbers the winners, and computes their planes as setup does.
    #[inline(always)]
    fn set_up(&mut self, plan: &FramePlan, cut: &RowCut) {
        let Self { search, winners, planes, numbers, seen, .. } = self;
        numbers.resize(cut.segments.len().max(numbers.len()), 0);
        seen.clear();
        for &segment in search.winners.iter().filter(|w| **w < UNSURE) {
            if std::mem::replace(&mut numbers[segment as usize], 1) == 0 {
                let of = &cut.segments[segment as usize];
                seen.push((u64::from(of.object) << 32 | u64::from(of.polygon), segment));
            }
        }
        seen.sort_unstable();
        let frame = Frame::new(plan);
        winners.clear();
        planes.clear();
        planes.push(DVec3::ZERO);
        for of_object in seen.chunk_by(|a, b| a.0 >> 32 == b.0 >> 32) {
            let object = (of_object[0].0 >> 32) as u32;
            let placed = frame.place(&cut.objects[cut.segments[of_object[0].1 as usize].place as usize]);
            for &(key, segment) in of_object {
                let polygon = key as u32;
                let of = &cut.segments[segment as usize];
                let corners = cut.corners(of);
                if cut.has_copies(segment) && !placed.has_one_nearest(corners) {
                    search.candidates.push(segment);
                    search.winners.iter_mut().filter(|w| **w == segment).for_each(|w| *w = UNSURE);
                }
                let (m, distance) = placed.plane(of.mesh_normal, corners);
                numbers[segment as usize] = planes.len() as u32;
                planes.push(m);
                winners.slots.push(0);
                winners.shades.push(Shade {
                    distance,
                    polygon_id: plan.drawn_polygon_id(object, polygon),
                    object_id: object + 1,
                });
            }
        }
    }

    /// Draws the candidates, as other predictions draw all polygons.
    #[inline(always)]
    fn decide<S: Simd>(&mut self, simd: S, plan: &FramePlan, cut: &RowCut, grid: &LineGrid, bands: &Bands) {
        let Self { search, lanes, winners, polygons, batch, buffer, .. } = self;
        let candidates = search.candidates.iter().flat_map(|s| cut.with_copies(*s));
        polygons.clear();
        polygons.extend(candidates.map(|s| (s.object, s.polygon)));
        polygons.sort_unstable();
        polygons.dedup();
        let lanes = lanes.get_or_insert_with(|| Box::new(PolygonLanes::new()));
        setup::fill_polygons(simd, batch, plan, polygons, lanes, bands);
        winners.number(batch);
        buffer.clear_farthest(bands.lines, 1, 0.0);
        raster_lines::rasterize(simd, buffer, grid, std::slice::from_ref(batch), &winners.slots, bands, 0);
    }

    /// Fills the z-buffer for decided beams, as the rasterizer does.
    #[inline(always)]
    fn fill(&mut self, grid: &LineGrid) {
        let Self { search, planes, numbers, buffer, .. } = self;
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

/// The frame of the rays.
struct Frame {
    image_from_world: DMat3,
    ray_from_image: DMat3,
    place: DVec3,
}

/// An object in the frame of the rays: the data for planes of `Instance` and `RayInstance`.
struct Placed {
    m_from_normal: DMat3,
    normal_from_mesh: DMat3,
    /// Metres per metre of a plane's distance in the mesh frame, if it is the same for all planes.
    uniform: Option<f64>,
    center: DVec3,
}

impl Frame {
    #[inline(always)]
    fn new(plan: &FramePlan) -> Self {
        let world_from_image = plan.world_from_sensor.rotation_matrix() * plan.sensor.body_from_image();
        let ray_from_image = match plan.sensor.grid() {
            PixelGrid::Lines(grid) => grid.image_from_line().transpose(),
            PixelGrid::Rays(_) => DMat3::IDENTITY,
        };
        let image_from_world = world_from_image.transpose();
        Self { image_from_world, ray_from_image, place: plan.world_from_sensor.translation }
    }

    #[inline(always)]
    fn place(&self, object: &CutObject) -> Placed {
        let normal_from_mesh = self.image_from_world * object.rotation * object.normal_from_mesh;
        let in_object = object.rotation.transpose() * (self.place - object.translation);
        Placed {
            m_from_normal: self.ray_from_image * normal_from_mesh,
            normal_from_mesh,
            uniform: instance::uniform_scale(&normal_from_mesh).map(f64::recip),
            center: object.mesh_from_object.transform_point3(in_object),
        }
    }
}

impl Placed {
    /// The vector m of a polygon's plane and its distance, metres, in the order of operations of
    /// `PolygonLanes::measure` and `PolygonLanes::set_up_planes`.
    #[inline(always)]
    fn plane(&self, normal: DVec3, corners: &[Vec3]) -> (DVec3, f64) {
        let DVec3 { x, y, z } = normal;
        let (mut least, mut distance) = (f64::INFINITY, 0.0);
        for p in corners {
            let p = p.as_dvec3() - self.center;
            let square = p.x * p.x + p.y * p.y + p.z * p.z;
            if square < least {
                (least, distance) = (square, x * p.x + y * p.y + z * p.z);
            }
        }
        let m = self.m_from_normal;
        let along = |of_x: f64, of_y: f64, of_z: f64| (of_x * x + of_y * y + of_z * z) / distance;
        let m = DVec3::new(
            along(m.x_axis.x, m.y_axis.x, m.z_axis.x),
            along(m.x_axis.y, m.y_axis.y, m.z_axis.y),
            along(m.x_axis.z, m.y_axis.z, m.z_axis.z),
        );
        let scale = match self.uniform {
            Some(scale) => scale,
            None => (self.normal_from_mesh * normal).length().recip(),
        };
        (m, distance.abs() * scale)
    }

    /// True if a single corner is nearest: planes of coincident faces are then measured at the same corner.
    fn has_one_nearest(&self, corners: &[Vec3]) -> bool {
        let squares = || corners.iter().map(|p| (p.as_dvec3() - self.center).length_squared());
        let least = squares().fold(f64::INFINITY, f64::min);
        squares().filter(|square| *square <= least * (1.0 + 1e-14)).count() == 1
    }
}

/// Fills the images after a search.
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
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { row, plan, cut, bands, target } = self;
        row.set_up(plan, cut);
        row.buffer.clear(bands.axis, bands.lines, bands.samples);
        if let PixelGrid::Lines(grid) = plan.sensor.grid() {
            if !row.search.candidates.is_empty() {
                row.decide(simd, plan, cut, grid, bands);
            }
            row.fill(grid);
        }
        resolve::resolve(target, &row.buffer, plan, &row.winners.shades, bands, 0, f32::INFINITY);
        row.seen.iter().for_each(|(_, segment)| row.numbers[*segment as usize] = 0);
    }
}

const _: () = assert!(NOTHING > UNSURE);
