//! Clouds to sweeps, and labels back to points.
//!
//! Rows are filled one by one in a row-major image, in which a ring stays in the first cache; the
//! image is transposed to the columns of a sweep at the end. All memory is reused for the next
//! cloud.

use std::f64::consts::TAU;

use fearless_simd::{Level, Simd, dispatch, f32x16, prelude::*, u32x16};

use super::places::{self, Placer};
use super::polar::{self, Polars};
use super::rings::{BeamFitter, Finder, Ring};
use super::rows::{Groups, RowTable};
use super::{Cloud, CloudError};
use sweepd_core::buffers::HeapBuffer;
use sweepd_core::buffers::{Buffers, HeapBuffers};
use sweepd_core::segment::{SAME_OBJECT_M, turn_over};
use sweepd_core::sensor::Beam;
use sweepd_core::sweep::layout::{COLUMNS_CAPACITY, LABEL_NONE, flags, is_return};
use sweepd_core::sweep::{Column, Shape, SweepMut};

/// Turns a second for the columns' times; a cloud has no times.
const TURNS_A_SECOND: f64 = 10.0;
/// Columns to either side in which a hidden point searches for a similar range.
const REACH: usize = 8;
/// Lines and columns that are transposed at once.
const TILE: usize = 16;

/// Projects clouds to sweeps; after the first clouds without allocating.
#[derive(Debug)]
pub struct CloudProjector {
    level: Level,
    /// Even columns of a whole turn.
    columns: Vec<Column>,
    buffers: HeapBuffers,
    buffer: Option<HeapBuffer>,
    polars: Polars,
    groups: Groups,
    finder: Finder,
    fitter: BeamFitter,
    rings: Vec<Ring>,
    placer: Placer,
    image: Image,
    labels: Vec<u32>,
}

/// The pixels of a cloud, row after row.
#[derive(Debug, Default)]
struct Image {
    range_m: Vec<f32>,
    /// Labels, and at the end one more: that of points without a pixel.
    label: Vec<u32>,
    /// Ranges of the points of a ring.
    ring_m: Vec<f32>,
    /// Pixel of each point, in the order of the rings; the one behind the last where it has none.
    pixel: Vec<u32>,
}

impl CloudProjector {
    /// Onto images of this many columns.
    ///
    /// # Errors
    /// [`CloudError::Columns`].
    pub fn new(columns: usize) -> Result<Self, CloudError> {
        if !(1..=COLUMNS_CAPACITY).contains(&columns) {
            return Err(CloudError::Columns { found: columns });
        }
        Ok(Self {
            level: Level::new(),
            columns: even_columns(columns),
            buffers: HeapBuffers::default(),
            buffer: None,
            polars: Polars::default(),
            groups: Groups::default(),
            finder: Finder::default(),
            fitter: BeamFitter::default(),
            rings: Vec::new(),
            placer: Placer::default(),
            image: Image::default(),
            labels: Vec::new(),
        })
    }

    /// A sweep of points that lie x forward, y left, z up, ring after ring; ready to be segmented.
    ///
    /// # Errors
    /// [`CloudError::Rings`] and [`CloudError::Order`].
    pub fn project(&mut self, points: &[[f32; 4]]) -> Result<SweepMut<'_>, CloudError> {
        self.polars.fill(self.level, points);
        self.finder.find(
            self.level,
            &self.polars,
            self.columns.len(),
            &mut self.rings,
        )?;
        self.groups.order.clear();
        self.fit_beams();
        self.draw()
    }

    /// A sweep of points in any order, with the ring number of each.
    ///
    /// # Errors
    /// [`CloudError::RingNumbers`]; [`CloudError::RingCount`] where there is not one number a
    /// point.
    pub fn project_rings(
        &mut self,
        points: &[[f32; 4]],
        rings: &[u32],
    ) -> Result<SweepMut<'_>, CloudError> {
        if rings.len() != points.len() {
            return Err(CloudError::RingCount {
                points: points.len(),
                rings: rings.len(),
            });
        }
        self.polars.fill(self.level, points);
        let rows = self.groups.by_number(rings)?;
        self.regroup(rows);
        self.fit_beams();
        self.draw()
    }

    /// A sweep of points in any order: each goes to the beam of the table that passes it nearest,
    /// which are the rows.
    ///
    /// # Errors
    /// [`CloudError::Layout`].
    pub fn project_rows(
        &mut self,
        points: &[[f32; 4]],
        table: &RowTable,
    ) -> Result<SweepMut<'_>, CloudError> {
        self.polars.fill(self.level, points);
        self.groups.by_beam(&self.polars, table);
        self.regroup(table.beams().len());
        for (ring, beam) in self.rings.iter_mut().zip(table.beams()) {
            (ring.elevation_rad, ring.vertical_offset_m) =
                (beam.elevation_rad, beam.vertical_offset_m);
        }
        self.draw()
    }

    /// A sweep of a cloud: by the table if there is one, else by its rings.
    ///
    /// # Errors
    /// Those of [`CloudProjector::project`], [`CloudProjector::project_rings`] and
    /// [`CloudProjector::project_rows`].
    pub fn project_cloud(
        &mut self,
        cloud: &Cloud,
        table: Option<&RowTable>,
    ) -> Result<SweepMut<'_>, CloudError> {
        match (table, &cloud.rings) {
            (Some(table), _) => self.project_rows(&cloud.points, table),
            (None, Some(rings)) => self.project_rings(&cloud.points, rings),
            (None, None) => self.project(&cloud.points),
        }
    }

    /// Puts points in the order of their groups, which become the rings.
    fn regroup(&mut self, rows: usize) {
        self.groups.sort(rows, &mut self.rings);
        self.groups
            .polars
            .fill_ordered(&self.polars, &self.groups.order);
        std::mem::swap(&mut self.polars, &mut self.groups.polars);
    }

    fn fit_beams(&mut self) {
        let Self {
            level,
            rings,
            polars,
            fitter,
            ..
        } = self;
        rings.retain(|ring| {
            polars.turn[ring.first..ring.end]
                .iter()
                .any(|turn| !turn.is_nan())
        });
        rings
            .iter_mut()
            .for_each(|ring| fitter.fit(*level, ring, polars));
        // Calibrated beams of the lower block can lie above those of the upper one in the order of
        // the file.
        rings.sort_unstable_by(|a, b| b.elevation_rad.total_cmp(&a.elevation_rad));
    }

    /// The sweep of the rings, which have their beams.
    fn draw(&mut self) -> Result<SweepMut<'_>, CloudError> {
        let rows = self.rings.len();
        let columns = self.columns.len();
        let pixels = rows * columns;
        self.image.clear(pixels, self.polars.turn.len());
        for (row, ring) in self.rings.iter().enumerate() {
            let of_ring = ring.first..ring.end;
            self.placer
                .place(self.level, &self.polars.turn[of_ring.clone()], columns);
            polar::ranges(
                self.level,
                &self.polars.away_m[of_ring.clone()],
                &self.polars.z_m[of_ring],
                ring.vertical_offset_m as f32,
                &mut self.image.ring_m,
            );
            self.image.draw(row, ring, &self.placer, columns);
        }
        // The last cloud's buffer goes back first, so that it can be taken again.
        drop(self.buffer.take());
        let shape = Shape {
            rows,
            columns_capacity: columns,
            dual: false,
            segments_capacity: pixels,
        };
        let buffer = self.buffer.insert(self.buffers.take(shape.total_bytes()));
        let mut sweep = SweepMut::create(buffer.as_mut(), &shape)?;
        fill_tables(&mut sweep, &self.rings, &self.columns);
        let by_row = &self.image.range_m;
        let by_column = &mut sweep.range[..pixels];
        dispatch!(self.level, simd => turn::<_, f32x16<_>>(simd, by_row, columns, by_column));
        sweep.header.returns = sweep.range[..pixels]
            .iter()
            .map(|&range_m| u32::from(is_return(range_m)))
            .sum();
        Ok(sweep)
    }

    /// Labels of the points of the last cloud in their order, once its sweep is segmented.
    ///
    /// # Errors
    /// [`CloudError::Layout`], if the sweep's header was spoilt.
    pub fn labels(&mut self) -> Result<&[u32], CloudError> {
        self.labels.clear();
        if let Some(buffer) = &mut self.buffer {
            let sweep = SweepMut::open(buffer.as_mut())?;
            let pixels = self.image.range_m.len();
            self.image.label.resize(pixels + 1, LABEL_NONE);
            let by_column = &sweep.label[..pixels];
            let by_row = &mut self.image.label[..pixels];
            dispatch!(self.level, simd => turn::<_, u32x16<_>>(simd, by_column, self.rings.len(), by_row));
            self.image.label[pixels] = LABEL_NONE;
            let pixels = self.image.pixel.iter();
            let labels = pixels.map(|&pixel| self.image.label[pixel as usize]);
            if self.groups.order.is_empty() {
                self.labels.extend(labels);
            } else {
                self.labels.resize(self.image.pixel.len(), LABEL_NONE);
                for (&point, label) in self.groups.order.iter().zip(labels) {
                    self.labels[point as usize] = label;
                }
            }
        }
        Ok(&self.labels)
    }

    /// The bytes of the last cloud's sweep.
    pub fn into_buffer(self) -> Option<HeapBuffer> {
        self.buffer
    }
}

impl Image {
    /// Makes room for this many pixels and points, all empty.
    fn clear(&mut self, pixels: usize, points: usize) {
        self.range_m.resize(pixels, 0.0);
        self.pixel.clear();
        self.pixel.resize(points, pixels as u32);
    }

    /// Puts the points of a ring into the pixels of a row, and notes the pixel of each.
    ///
    /// If more points fall on a column than there is room around it, points share a pixel: the
    /// nearer is segmented, and the other takes the label of the most similar pixel.
    fn draw(&mut self, row: usize, ring: &Ring, placed: &Placer, columns: usize) {
        let first = row * columns;
        let nowhere = self.range_m.len() as u32;
        let shown = &mut self.range_m[first..first + columns];
        for (shown, &point) in shown.iter_mut().zip(&placed.points) {
            *shown = self.ring_m.get(point as usize).copied().unwrap_or(0.0);
        }
        let pixels = &mut self.pixel[ring.first..ring.end];
        for (pixel, &column) in pixels.iter_mut().zip(&placed.columns) {
            *pixel = if column == places::NONE {
                nowhere
            } else {
                first as u32 + column
            };
        }
        for &point in &placed.crowded {
            let shown = &mut shown[placed.columns[point as usize] as usize];
            *shown = shown.min(self.ring_m[point as usize]);
        }
        for &point in &placed.crowded {
            let column = placed.columns[point as usize] as usize;
            for point in [point, placed.points[column]] {
                let range_m = self.ring_m[point as usize];
                pixels[point as usize] = (first + resembling(shown, column, range_m)) as u32;
            }
        }
    }
}

/// The column whose label a hidden point takes: its own, unless the point shown there is more than
/// [`SAME_OBJECT_M`] away from it in range. Then the column within [`REACH`] whose range is most
/// like the point's, or its own, if none is within [`SAME_OBJECT_M`].
fn resembling(shown: &[f32], own: usize, range_m: f32) -> usize {
    let columns = shown.len();
    if (shown[own] - range_m).abs() <= SAME_OBJECT_M {
        return own;
    }
    let around = (0..=2 * REACH).map(|by| (own + columns * REACH + by - REACH) % columns);
    around
        .map(|column| (column, (shown[column] - range_m).abs()))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .filter(|&(_, apart_m)| apart_m <= SAME_OBJECT_M)
        .map_or(own, |(column, _)| column)
}

/// Writes pixels that stand line after line, `width` pixels each, column after column.
#[inline(always)]
fn turn<S: Simd, V: SimdBase<S>>(
    simd: S,
    from: &[V::Element],
    width: usize,
    to: &mut [V::Element],
) {
    let height = from.len().checked_div(width).unwrap_or(0);
    for left in (0..width).step_by(TILE) {
        for top in (0..height).step_by(TILE) {
            if left + TILE <= width && top + TILE <= height {
                turn_tile::<S, V>(
                    simd,
                    &from[top * width + left..],
                    width,
                    &mut to[left * height + top..],
                    height,
                );
                continue;
            }
            for across in left..width.min(left + TILE) {
                for down in top..height.min(top + TILE) {
                    to[across * height + down] = from[down * width + across];
                }
            }
        }
    }
}

/// [`turn`] of a square of [`TILE`] by [`TILE`] pixels.
#[inline(always)]
fn turn_tile<S: Simd, V: SimdBase<S>>(
    simd: S,
    from: &[V::Element],
    width: usize,
    to: &mut [V::Element],
    height: usize,
) {
    let mut tile = [V::from_slice(simd, &from[..TILE]); TILE];
    for line in 1..TILE {
        tile[line] = V::from_slice(simd, &from[line * width..][..TILE]);
    }
    let tile = turn_over(tile);
    for across in 0..TILE {
        tile[across].store_slice(&mut to[across * height..][..TILE]);
    }
}

/// The columns of a turn.
fn even_columns(columns: usize) -> Vec<Column> {
    let rate_rad_s = (TAU * TURNS_A_SECOND) as f32;
    (0..columns)
        .map(|index| {
            let azimuth_rad = (index as f64 + 0.5) / columns as f64 * TAU;
            let time_ns = index as f64 / columns as f64 / TURNS_A_SECOND * 1e9;
            Column::measured(0, 0, azimuth_rad as f32, rate_rad_s, time_ns as u32)
        })
        .collect()
}

/// Writes header and tables of the sweep: a whole turn of even columns.
fn fill_tables(sweep: &mut SweepMut<'_>, rings: &[Ring], columns: &[Column]) {
    sweep.header.columns = columns.len() as u32;
    sweep.header.flags = flags::CIRCULAR;
    sweep.header.rpm = (60.0 * TURNS_A_SECOND) as f32;
    sweep.header.duration_ns = (1e9 / TURNS_A_SECOND) as u64;
    let pixels = columns.len() * rings.len();
    sweep.reflectivity[..pixels].fill(0);
    sweep.label[..pixels].fill(LABEL_NONE);
    sweep.columns.copy_from_slice(columns);
    for (row, (beam, ring)) in sweep.beams.iter_mut().zip(rings).enumerate() {
        let fitted = Beam {
            vertical_offset_m: ring.vertical_offset_m,
            ..Beam::ideal(row, ring.elevation_rad)
        };
        *beam = fitted.row(0);
    }
}
