//! A sweep to read and to fill: views over the bytes that [`super::layout`] defines.

use std::f64::consts::TAU;

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use super::layout::*;
use crate::wire::data::ReturnMode;

/// A sweep to read: a view over its bytes, trimmed to the columns and segments that are there.
#[derive(Clone, Copy)]
pub struct SweepRef<'a> {
    /// The header.
    pub header: &'a Header,
    /// Metres, column after column: `[column * rows + row]`. See [`is_return`].
    pub range: &'a [f32],
    /// Calibrated reflectivity.
    pub reflectivity: &'a [u8],
    /// 0 none, 1 ground, 2.. segment.
    pub label: &'a [u32],
    /// The other return, empty in single mode.
    pub range2: &'a [f32],
    /// The other return's reflectivity.
    pub reflectivity2: &'a [u8],
    /// The other return's label.
    pub label2: &'a [u32],
    /// [`ReturnKind`] of the segmented return, empty in single mode.
    pub kind: &'a [u8],
    /// The firings.
    pub columns: &'a [Column],
    /// The beams.
    pub beams: &'a [BeamRow],
    /// The segments, by label.
    pub segments: &'a [Segment],
}

/// A sweep to fill: a view over its bytes in their full capacity.
pub struct SweepMut<'a> {
    /// The header.
    pub header: &'a mut Header,
    /// Metres; see [`SweepRef::range`].
    pub range: &'a mut [f32],
    /// Calibrated reflectivity.
    pub reflectivity: &'a mut [u8],
    /// 0 none, 1 ground, 2.. segment.
    pub label: &'a mut [u32],
    /// The other return, empty in single mode.
    pub range2: &'a mut [f32],
    /// The other return's reflectivity.
    pub reflectivity2: &'a mut [u8],
    /// The other return's label.
    pub label2: &'a mut [u32],
    /// [`ReturnKind`] of the segmented return.
    pub kind: &'a mut [u8],
    /// The firings.
    pub columns: &'a mut [Column],
    /// The beams.
    pub beams: &'a mut [BeamRow],
    /// The segments.
    pub segments: &'a mut [Segment],
}

impl<'a> SweepMut<'a> {
    /// Writes the header of an empty sweep of this shape and gives the view.
    ///
    /// # Errors
    /// [`LayoutError::Bytes`] when the slice is too short or not aligned.
    pub fn create(bytes: &'a mut [u8], shape: &Shape) -> Result<Self, LayoutError> {
        let too_short = LayoutError::Bytes { bytes: bytes.len() };
        if bytes.len() < shape.total_bytes() {
            return Err(too_short);
        }
        let (header, _) = Header::mut_from_prefix(&mut *bytes).map_err(|_| too_short)?;
        *header = Header::new(shape);
        Self::open(bytes)
    }

    /// The view over a sweep that was [created](Self::create) in these bytes.
    ///
    /// # Errors
    /// [`LayoutError`] when the bytes are no sweep.
    pub fn open(bytes: &'a mut [u8]) -> Result<Self, LayoutError> {
        let found = bytes.len();
        let (header, mut rest) = Header::mut_from_prefix(bytes).map_err(|_| LayoutError::Bytes { bytes: found })?;
        let shape = checked_shape(header, found)?;
        let mut at = size_of::<Header>();
        let sizes = shape.part_bytes();
        let mut parts: [&mut [u8]; PARTS] = Default::default();
        for ((part, &offset), &size) in parts.iter_mut().zip(&header.offsets).zip(&sizes) {
            if size > 0 {
                let (_, tail) = std::mem::take(&mut rest).split_at_mut(offset as usize - at);
                let (this, tail) = tail.split_at_mut(size);
                *part = this;
                rest = tail;
                at = offset as usize + size;
            }
        }
        let [range, reflectivity, label, range2, reflectivity2, label2, kind, columns, beams, segments] = parts;
        Ok(Self {
            header,
            range: cast_mut(range)?,
            reflectivity,
            label: cast_mut(label)?,
            range2: cast_mut(range2)?,
            reflectivity2,
            label2: cast_mut(label2)?,
            kind,
            columns: cast_mut(columns)?,
            beams: cast_mut(beams)?,
            segments: cast_mut(segments)?,
        })
    }

    /// Columns that are filled.
    pub fn column_count(&self) -> usize {
        self.header.columns as usize
    }

    /// The same sweep, to read: trimmed to what is filled.
    pub fn as_ref(&self) -> SweepRef<'_> {
        let columns = self.header.columns as usize;
        let pixels = columns * self.header.rows as usize;
        let other = if self.range2.is_empty() { 0 } else { pixels };
        SweepRef {
            header: self.header,
            range: &self.range[..pixels],
            reflectivity: &self.reflectivity[..pixels],
            label: &self.label[..pixels],
            range2: &self.range2[..other],
            reflectivity2: &self.reflectivity2[..other],
            label2: &self.label2[..other],
            kind: &self.kind[..other],
            columns: &self.columns[..columns],
            beams: self.beams,
            segments: &self.segments[..self.header.segments as usize],
        }
    }
}

fn cast_mut<T: FromBytes + IntoBytes + KnownLayout + Immutable>(bytes: &mut [u8]) -> Result<&mut [T], LayoutError> {
    let found = bytes.len();
    if found == 0 {
        return Ok(&mut []);
    }
    <[T]>::mut_from_bytes(bytes).map_err(|_| LayoutError::Bytes { bytes: found })
}

fn cast_ref<T: FromBytes + KnownLayout + Immutable>(bytes: &[u8]) -> Result<&[T], LayoutError> {
    if bytes.is_empty() {
        return Ok(&[]);
    }
    <[T]>::ref_from_bytes(bytes).map_err(|_| LayoutError::Bytes { bytes: bytes.len() })
}

/// One return of a sweep with all that is known of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Return {
    /// Row, 0 the highest.
    pub row: usize,
    /// Column.
    pub column: usize,
    /// Index of the record within its firing.
    pub channel: usize,
    /// Ordinal of its data packet among this sensor's.
    pub packet: u64,
    /// Block within the packet.
    pub block: u8,
    /// Strongest or last.
    pub kind: ReturnKind,
    /// Metres along the beam.
    pub range_m: f32,
    /// Azimuth of the beam when it fired, radians, 0..2 pi, clockwise from +y.
    pub azimuth_rad: f64,
    /// Angle of the beam above the horizon, radians.
    pub elevation_rad: f64,
    /// Calibrated reflectivity.
    pub reflectivity: u8,
    /// When the beam fired, nanoseconds since 1970 in the clock of [`Header::time_source`].
    pub time_ns: i64,
    /// 0 none, 1 ground, 2.. segment.
    pub label: u32,
    /// x right, y forward, z up, metres from the sensor's origin; the beam's origin offsets are in it.
    pub point_m: [f64; 3],
}

impl<'a> SweepRef<'a> {
    /// The view over the bytes of a sweep, checked so that nothing in it can be out of bounds.
    ///
    /// # Errors
    /// [`LayoutError`].
    pub fn open(bytes: &'a [u8]) -> Result<Self, LayoutError> {
        let (header, _) = Header::ref_from_prefix(bytes).map_err(|_| LayoutError::Bytes { bytes: bytes.len() })?;
        let shape = checked_shape(header, bytes.len())?;
        let columns = header.columns as usize;
        let pixels = columns * shape.rows;
        let other = if shape.dual { pixels } else { 0 };
        let part = |part: Part, len: usize| {
            let start = header.offsets[part as usize] as usize;
            &bytes[start..start + len]
        };
        Ok(Self {
            header,
            range: cast_ref(part(Part::Range, pixels * 4))?,
            reflectivity: part(Part::Reflectivity, pixels),
            label: cast_ref(part(Part::Label, pixels * 4))?,
            range2: cast_ref(part(Part::Range2, other * 4))?,
            reflectivity2: part(Part::Reflectivity2, other),
            label2: cast_ref(part(Part::Label2, other * 4))?,
            kind: part(Part::Kind, other),
            columns: cast_ref(part(Part::Columns, columns * size_of::<Column>()))?,
            beams: cast_ref(part(Part::Beams, shape.rows * size_of::<BeamRow>()))?,
            segments: cast_ref(part(Part::Segments, header.segments as usize * size_of::<Segment>()))?,
        })
    }

    /// Rows of the image.
    pub fn rows(&self) -> usize {
        self.beams.len()
    }

    /// Azimuth of a pixel's beam when it fired, radians, 0..2 pi.
    #[inline]
    pub fn azimuth_rad(&self, row: usize, column: usize) -> f64 {
        pixel_azimuth_rad(&self.columns[column], &self.beams[row])
    }

    /// When a pixel's beam fired, nanoseconds since 1970 in the clock of [`Header::time_source`].
    #[inline]
    pub fn time_ns(&self, row: usize, column: usize) -> i64 {
        self.header.time_ns + i64::from(self.columns[column].time_ns) + i64::from(self.beams[row].time_offset_ns)
    }

    /// x right, y forward, z up of a range in a pixel, metres.
    #[inline]
    pub fn point_m(&self, row: usize, column: usize, range_m: f32) -> [f64; 3] {
        pixel_point_m(&self.columns[column], &self.beams[row], range_m)
    }

    /// All returns, column after column, from the top row down; of a dual pixel the segmented one first.
    pub fn returns(&self) -> impl Iterator<Item = Return> + '_ {
        (0..self.columns.len())
            .flat_map(move |column| (0..self.rows()).flat_map(move |row| self.pixel(row, column).into_iter().flatten()))
    }

    /// The returns of a pixel: the segmented one and the other.
    pub fn pixel(&self, row: usize, column: usize) -> [Option<Return>; 2] {
        let index = column * self.rows() + row;
        let first = (self.range[index], self.reflectivity[index], self.label[index]);
        let kind = self.kind_of(index);
        let second = self.range2.get(index).map(|&range| {
            let other = match kind {
                ReturnKind::Strongest => ReturnKind::Last,
                ReturnKind::Last => ReturnKind::Strongest,
            };
            self.at(row, column, other, (range, self.reflectivity2[index], self.label2[index]))
        });
        [self.at(row, column, kind, first), second.flatten()]
    }

    fn kind_of(&self, index: usize) -> ReturnKind {
        let last = match self.kind.get(index) {
            Some(&kind) => kind == ReturnKind::Last as u8,
            None => self.header.return_mode() == ReturnMode::Last,
        };
        if last { ReturnKind::Last } else { ReturnKind::Strongest }
    }

    fn at(&self, row: usize, column: usize, kind: ReturnKind, values: (f32, u8, u32)) -> Option<Return> {
        let (range_m, reflectivity, label) = values;
        if !is_return(range_m) {
            return None;
        }
        let (firing, beam) = (&self.columns[column], &self.beams[row]);
        let odd_block = self.header.return_mode() == ReturnMode::Dual && kind == ReturnKind::Strongest;
        Some(Return {
            row,
            column,
            channel: beam.channel as usize,
            packet: firing.packet,
            block: firing.block.wrapping_add(u8::from(odd_block)),
            kind,
            range_m,
            azimuth_rad: self.azimuth_rad(row, column),
            elevation_rad: f64::from(beam.elevation_rad),
            reflectivity,
            time_ns: self.time_ns(row, column),
            label,
            point_m: self.point_m(row, column, range_m),
        })
    }
}

/// Azimuth of a beam of a firing at its own shot, radians, 0..2 pi.
#[inline]
pub fn pixel_azimuth_rad(column: &Column, beam: &BeamRow) -> f64 {
    let turned = f64::from(column.azimuth_rate_rad_s) * f64::from(beam.time_offset_ns) * 1e-9;
    let azimuth = (f64::from(column.azimuth_rad) + turned - f64::from(beam.rotation_rad)).rem_euclid(TAU);
    // A hair below 0 is rounded to a whole turn.
    if azimuth < TAU { azimuth } else { 0.0 }
}

/// x right, y forward, z up of a range along a beam of a firing, metres (VLP-16 User Manual, section 9.2, plus the
/// beam's origin offsets).
#[inline]
pub fn pixel_point_m(column: &Column, beam: &BeamRow, range_m: f32) -> [f64; 3] {
    let (sin_azimuth, cos_azimuth) = pixel_azimuth_rad(column, beam).sin_cos();
    let (sin_elevation, cos_elevation) = f64::from(beam.elevation_rad).sin_cos();
    let range = f64::from(range_m);
    let sideways = f64::from(beam.horizontal_offset_m);
    [
        range * cos_elevation * sin_azimuth - sideways * cos_azimuth,
        range * cos_elevation * cos_azimuth + sideways * sin_azimuth,
        range * sin_elevation + f64::from(beam.vertical_offset_m),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::Beam;
    use crate::sweep::buffers::{Buffers, HeapBuffers};

    const SHAPE: Shape = Shape { rows: 3, columns_capacity: 5, dual: true, segments_capacity: 2 };

    #[test]
    fn what_is_written_is_read_and_a_wrong_header_is_refused() {
        let mut buffer = HeapBuffers::default().take(SHAPE.total_bytes());
        let bytes: &mut [u8] = buffer.as_mut();
        bytes.fill(0xA5);
        let sweep = SweepMut::create(bytes, &SHAPE).unwrap();
        sweep.range[4] = 2.0;
        sweep.label2[5] = 7;
        sweep.columns[1] = Column::measured(9, 4, 1.5, 60.0, 11);
        sweep.beams[2] = BeamRow::new(&Beam::ideal(1, -0.25), 2304);
        sweep.header.columns = 2;
        let read = SweepRef::open(bytes).unwrap();
        assert_eq!((read.range.len(), read.range[4], read.label2[5]), (6, 2.0, 7));
        assert_eq!((read.columns.len(), read.columns[1].packet, read.beams[2].channel), (2, 9, 1));

        assert_eq!(SweepRef::open(&bytes[..100]).err(), Some(LayoutError::Bytes { bytes: 100 }));
        SweepMut::open(bytes).unwrap().header.columns = 6;
        assert_eq!(SweepRef::open(bytes).err(), Some(LayoutError::Inconsistent));
        bytes[0] = 0;
        assert!(matches!(SweepRef::open(bytes), Err(LayoutError::Version { .. })));
    }

    /// By hand: azimuth 90 degrees is +x; 30 degrees up at 2 m is 1.732 m out and 1 m up.
    #[test]
    fn axes_are_those_of_the_manual() {
        let raised = Beam { vertical_offset_m: 0.01, ..Beam::ideal(0, 30_f64.to_radians()) };
        let beam = BeamRow::new(&raised, 1_000_000);
        let column = Column::measured(0, 0, 80_f32.to_radians(), 10_f32.to_radians() * 1000.0, 0);
        let [x, y, z] = pixel_point_m(&column, &beam, 2.0);
        assert!((x - 1.732_050_8).abs() < 1e-6 && y.abs() < 1e-6 && (z - 1.01).abs() < 1e-6);
    }
}
