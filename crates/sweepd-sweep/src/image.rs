//! A sweep to read and to fill: views over the bytes that [`super::layout`] defines.

use std::f64::consts::TAU;
use std::ops::Range;

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use super::corrected::Corrected;
use super::layout::*;
use super::order::PixelsByTime;
use super::pose::{Frame, Pose};
use super::sensor::{Model, Places, RECORDS, ReturnMode};

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

/// A sweep to fill: a view over its bytes in their full capacity, margin included.
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
    /// Writes the header of an empty sweep of this shape and returns the view.
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
    /// [`LayoutError`] when the bytes are not a sweep.
    pub fn open(bytes: &'a mut [u8]) -> Result<Self, LayoutError> {
        let found = bytes.len();
        let (header, mut rest) =
            Header::mut_from_prefix(bytes).map_err(|_| LayoutError::Bytes { bytes: found })?;
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
        let [
            range,
            reflectivity,
            label,
            range2,
            reflectivity2,
            label2,
            kind,
            columns,
            beams,
            segments,
        ] = parts;
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

    /// Columns of the image, as indices of the table of columns.
    pub fn image_columns(&self) -> Range<usize> {
        let margin = self.header.margin_columns as usize;
        margin..margin + self.header.columns as usize
    }

    /// Pixels of the image, as indices of each plane.
    pub fn image_pixels(&self) -> Range<usize> {
        let (Range { start, end }, rows) = (self.image_columns(), self.header.rows as usize);
        start * rows..end * rows
    }

    /// The same sweep, to read: trimmed to what is filled.
    pub fn as_ref(&self) -> SweepRef<'_> {
        let pixels = self.image_pixels();
        let other = if self.range2.is_empty() {
            0..0
        } else {
            pixels.clone()
        };
        SweepRef {
            header: self.header,
            range: &self.range[pixels.clone()],
            reflectivity: &self.reflectivity[pixels.clone()],
            label: &self.label[pixels],
            range2: &self.range2[other.clone()],
            reflectivity2: &self.reflectivity2[other.clone()],
            label2: &self.label2[other.clone()],
            kind: &self.kind[other],
            columns: &self.columns[self.image_columns()],
            beams: self.beams,
            segments: &self.segments[..self.header.segments as usize],
        }
    }
}

fn cast_mut<T: FromBytes + IntoBytes + KnownLayout + Immutable>(
    bytes: &mut [u8],
) -> Result<&mut [T], LayoutError> {
    let found = bytes.len();
    if found == 0 {
        return Ok(&mut []);
    }
    <[T]>::mut_from_bytes(bytes).map_err(|_| LayoutError::Bytes { bytes: found })
}

/// Copies to the beginning of a part; `false` where that is too short.
fn fill<T: Copy>(part: &mut [T], from: &[T]) -> bool {
    let room = part.get_mut(..from.len());
    room.map(|part| part.copy_from_slice(from)).is_some()
}

/// The bytes of a sweep whose header was checked.
struct PartBytes<'a> {
    header: &'a Header,
    bytes: &'a [u8],
}

impl<'a> PartBytes<'a> {
    /// Items of a part.
    fn part<T: FromBytes + KnownLayout + Immutable>(
        &self,
        part: Part,
        items: &Range<usize>,
    ) -> Result<&'a [T], LayoutError> {
        if items.is_empty() {
            return Ok(&[]);
        }
        let start = self.header.offsets[part as usize] as usize;
        let size = size_of::<T>();
        let bytes = &self.bytes[start + items.start * size..start + items.end * size];
        <[T]>::ref_from_bytes(bytes).map_err(|_| LayoutError::Bytes { bytes: bytes.len() })
    }
}

/// One return as the planes of the image hold it.
#[derive(Clone, Copy)]
struct StoredReturn {
    range_m: f32,
    reflectivity: u8,
    label: u32,
    kind: ReturnKind,
    in_second_blocks: bool,
}

/// One return of a sweep with all its properties.
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
    /// x right, y forward, z up, metres from the sensor's origin; the beam's origin offsets are in
    /// it.
    pub point_m: [f64; 3],
}

impl<'a> SweepRef<'a> {
    /// The view over the bytes of a sweep, checked so that nothing in it can be out of bounds. The
    /// bytes must not change; for shared memory, where a publisher may still write, see
    /// [`SweepRef::with_header`].
    ///
    /// # Errors
    /// [`LayoutError`].
    pub fn open(bytes: &'a [u8]) -> Result<Self, LayoutError> {
        let (header, _) = Header::ref_from_prefix(bytes)
            .map_err(|_| LayoutError::Bytes { bytes: bytes.len() })?;
        Self::with_header(header, bytes)
    }

    /// The same with a copy of the header of these bytes. Others may write to the bytes at the same
    /// time: only the checked copy is used, and the header in the bytes is not read again.
    ///
    /// # Errors
    /// [`LayoutError`].
    pub fn with_header(header: &'a Header, bytes: &'a [u8]) -> Result<Self, LayoutError> {
        let shape = checked_shape(header, bytes.len())?;
        let margin = header.margin_columns as usize;
        let columns = margin..margin + header.columns as usize;
        let pixels = columns.start * shape.rows..columns.end * shape.rows;
        let other = if shape.dual { pixels.clone() } else { 0..0 };
        let bytes = PartBytes { header, bytes };
        Ok(Self {
            header,
            range: bytes.part(Part::Range, &pixels)?,
            reflectivity: bytes.part(Part::Reflectivity, &pixels)?,
            label: bytes.part(Part::Label, &pixels)?,
            range2: bytes.part(Part::Range2, &other)?,
            reflectivity2: bytes.part(Part::Reflectivity2, &other)?,
            label2: bytes.part(Part::Label2, &other)?,
            kind: bytes.part(Part::Kind, &other)?,
            columns: bytes.part(Part::Columns, &columns)?,
            beams: bytes.part(Part::Beams, &(0..shape.rows))?,
            segments: bytes.part(Part::Segments, &(0..header.segments as usize))?,
        })
    }

    /// The smallest shape that holds this sweep and this many segments.
    pub fn packed_shape(&self, segments: usize) -> Shape {
        Shape {
            columns_capacity: self.columns.len(),
            segments_capacity: segments,
            ..self.header.shape()
        }
    }

    /// Copies this sweep, without its margin, to bytes of this [packed shape](Self::packed_shape).
    ///
    /// # Errors
    /// [`LayoutError::Bytes`] when they are too few or not aligned; [`LayoutError::Inconsistent`]
    /// when the shape has less room than this sweep needs.
    pub fn pack(&self, shape: &Shape, bytes: &mut [u8]) -> Result<(), LayoutError> {
        let to = SweepMut::create(bytes, shape)?;
        let empty = *to.header;
        *to.header = *self.header;
        to.header.margin_columns = 0;
        to.header.segments = self.segments.len() as u32;
        to.header.columns_capacity = empty.columns_capacity;
        to.header.segments_capacity = empty.segments_capacity;
        (to.header.offsets, to.header.total_bytes) = (empty.offsets, empty.total_bytes);
        let copied = fill(to.range, self.range)
            && fill(to.reflectivity, self.reflectivity)
            && fill(to.label, self.label)
            && fill(to.range2, self.range2)
            && fill(to.reflectivity2, self.reflectivity2)
            && fill(to.label2, self.label2)
            && fill(to.kind, self.kind)
            && fill(to.columns, self.columns)
            && fill(to.beams, self.beams)
            && fill(to.segments, self.segments);
        if copied {
            Ok(())
        } else {
            Err(LayoutError::Inconsistent)
        }
    }

    /// Rows of the image.
    pub fn rows(&self) -> usize {
        self.beams.len()
    }

    /// The column in which a pixel was fired: its own plus the shift of its row. Beyond the ends of
    /// an image that is not circular, where no pixel has a return, the column at the end.
    #[inline]
    pub fn fired_in(&self, row: usize, column: usize) -> usize {
        let circular = self.header.has(flags::CIRCULAR);
        shifted(column, self.beams[row].shift, self.columns.len(), circular)
    }

    /// The firing that a pixel belongs to.
    #[inline]
    pub fn firing(&self, row: usize, column: usize) -> &Column {
        &self.columns[self.fired_in(row, column)]
    }

    /// Azimuth of a pixel's beam when it fired, radians, 0..2 pi. A return of a beam with a
    /// two-point correction is slightly to its side, at [`Return::azimuth_rad`].
    #[inline]
    pub fn azimuth_rad(&self, row: usize, column: usize) -> f64 {
        pixel_azimuth_rad(self.firing(row, column), &self.beams[row])
    }

    /// When a pixel's beam fired, nanoseconds since 1970 in the clock of [`Header::time_source`].
    #[inline]
    pub fn time_ns(&self, row: usize, column: usize) -> i64 {
        let firing = self.firing(row, column);
        shot_ns(self.header, firing, &self.beams[row])
    }

    /// x right, y forward, z up of a range in a pixel, metres.
    #[inline]
    pub fn point_m(&self, row: usize, column: usize, range_m: f32) -> [f64; 3] {
        pixel_point_m(self.firing(row, column), &self.beams[row], range_m)
    }

    /// All returns, column after column, from the top row down; of a dual pixel the segmented one
    /// first.
    pub fn returns(&self) -> impl Iterator<Item = Return> + '_ {
        (0..self.columns.len()).flat_map(move |column| {
            (0..self.rows()).flat_map(move |row| self.pixel(row, column).into_iter().flatten())
        })
    }

    /// All pixels that can have a return, in the order in which their beams fired.
    pub fn pixels_by_time(&self) -> PixelsByTime<'a> {
        PixelsByTime::of(*self)
    }

    /// All returns with the points in a frame, by the mount in the header; in the order of
    /// [`SweepRef::returns`].
    pub fn points(&self, frame: Frame) -> impl Iterator<Item = Return> + '_ {
        self.in_frame(self.returns(), frame)
    }

    /// The same in the order in which the beams fired: times never step back. Of a dual pixel, the
    /// segmented return is first.
    pub fn points_by_time(&self, frame: Frame) -> impl Iterator<Item = Return> + '_ {
        let pixels = self.pixels_by_time();
        let pairs = pixels.flat_map(|one| self.pixel(one.row, one.column));
        self.in_frame(pairs.flatten(), frame)
    }

    fn in_frame(
        &self,
        returns: impl Iterator<Item = Return>,
        frame: Frame,
    ) -> impl Iterator<Item = Return> {
        let pose = frame.pose(Pose::of_mount(self.header));
        returns.map(move |mut one| {
            if let Some(pose) = &pose {
                one.point_m = pose.apply(one.point_m);
            }
            one
        })
    }

    /// The box of each segment in a frame, by the mount in the header: least and greatest x, y and
    /// z, metres. In another frame than the sensor's it is the box around the box.
    pub fn boxes(&self, frame: Frame) -> impl Iterator<Item = [[f64; 3]; 2]> + '_ {
        let pose = frame.pose(Pose::of_mount(self.header));
        let segments = self.segments.iter();
        segments.map(move |segment| segment.box_in(pose.as_ref()))
    }

    /// All returns with the points in any frame: `pose_at` gives the pose of the sensor in it at
    /// the time of the return's own shot, nanoseconds since 1970 in the clock of
    /// [`Header::time_source`]. With the poses of a moving sensor, this deskews the sweep.
    ///
    /// ```
    /// # use sweepd_sweep::{Pose, SweepRef};
    /// # fn odometry(time_ns: i64) -> Pose { Pose::IDENTITY }
    /// # fn show(sweep: SweepRef<'_>) {
    /// let mount = Pose::of_mount(sweep.header);
    /// let in_world = sweep.points_in(|time_ns| odometry(time_ns) * mount);
    /// # }
    /// ```
    pub fn points_in(&self, mut pose_at: impl FnMut(i64) -> Pose) -> impl Iterator<Item = Return> {
        self.returns().map(move |mut one| {
            one.point_m = pose_at(one.time_ns).apply(one.point_m);
            one
        })
    }

    /// The returns of a pixel: the segmented one and the other.
    ///
    /// # Panics
    /// If the image does not have the row or the column; so do all methods here that take one.
    pub fn pixel(&self, row: usize, column: usize) -> [Option<Return>; 2] {
        let index = column * self.rows() + row;
        let mut segmented = StoredReturn {
            range_m: self.range[index],
            reflectivity: self.reflectivity[index],
            label: self.label[index],
            kind: match self.header.return_mode() {
                ReturnMode::Last => ReturnKind::Last,
                _ => ReturnKind::Strongest,
            },
            in_second_blocks: false,
        };
        let Some(&byte) = self.kind.get(index) else {
            return [self.at(row, column, segmented), None];
        };
        segmented.kind = ReturnKind::of_byte(byte);
        segmented.in_second_blocks = byte & SECOND_BLOCKS != 0;
        let other = StoredReturn {
            range_m: self.range2[index],
            reflectivity: self.reflectivity2[index],
            label: self.label2[index],
            kind: segmented.kind.other(),
            in_second_blocks: !segmented.in_second_blocks,
        };
        [self.at(row, column, segmented), self.at(row, column, other)]
    }

    /// Where the returns of an azimuth are in a packet; as those of a VLP-16 for a model that this
    /// program does not know.
    fn places(&self) -> Places {
        let model = Model::from_code(self.header.model).unwrap_or(Model::Vlp16);
        model.places(self.header.return_mode())
    }

    fn at(&self, row: usize, column: usize, stored: StoredReturn) -> Option<Return> {
        if !is_return(stored.range_m) {
            return None;
        }
        let firing = self.firing(row, column);
        let beam = &self.beams[row];
        let places = self.places();
        let bank = beam.channel as usize / RECORDS;
        let number = usize::from(stored.in_second_blocks);
        let block = bank * places.bank_step + number * places.return_step;
        let shot = Shot::new(firing, beam);
        let along_m = shot.along_m(stored.range_m);
        let [azimuth_rad, elevation_rad] = shot.direction_rad(along_m);
        Some(Return {
            row,
            column,
            channel: beam.channel as usize,
            packet: firing.packet,
            block: firing.block.wrapping_add(block as u8),
            kind: stored.kind,
            range_m: stored.range_m,
            azimuth_rad,
            elevation_rad,
            reflectivity: stored.reflectivity,
            time_ns: shot_ns(self.header, firing, beam),
            label: stored.label,
            point_m: shot.point_m(along_m),
        })
    }
}

/// The column that is `shift` columns further.
#[inline]
pub fn shifted(column: usize, shift: i32, columns: usize, circular: bool) -> usize {
    let at = column as i64 + i64::from(shift);
    turned_to(at, columns, circular).unwrap_or_else(|| at.clamp(0, columns as i64 - 1) as usize)
}

/// The column of this number in an image that goes on beyond its ends, if it is circular.
#[inline]
pub(crate) fn turned_to(at: i64, columns: usize, circular: bool) -> Option<usize> {
    match usize::try_from(at) {
        Ok(at) if at < columns => Some(at),
        _ if circular => Some(at.rem_euclid(columns as i64) as usize),
        _ => None,
    }
}

/// When a beam of a firing fired; saturates for a header with invalid times.
#[inline]
fn shot_ns(header: &Header, firing: &Column, beam: &BeamRow) -> i64 {
    header
        .time_ns
        .saturating_add(i64::from(firing.time_ns) + i64::from(beam.time_offset_ns))
}

/// Azimuth of a beam of a firing at its own shot, radians, 0..2 pi.
#[inline]
pub fn pixel_azimuth_rad(column: &Column, beam: &BeamRow) -> f64 {
    let turned = f64::from(column.azimuth_rate_rad_s) * f64::from(beam.time_offset_ns) * 1e-9;
    let azimuth =
        (f64::from(column.azimuth_rad) + turned - f64::from(beam.rotation_rad)).rem_euclid(TAU);
    // A value just below 0 is rounded to a whole turn.
    if azimuth < TAU { azimuth } else { 0.0 }
}

/// x right, y forward, z up of a range along a beam of a firing, metres (VLP-16 User Manual,
/// section 9.2; HDL-64E S3 manual, for the beam's origin offsets and the
/// [corrected](super::corrected) beam).
#[inline]
pub fn pixel_point_m(column: &Column, beam: &BeamRow, range_m: f32) -> [f64; 3] {
    let shot = Shot::new(column, beam);
    shot.point_m(shot.along_m(range_m))
}

/// A shot of a beam, and its direction.
struct Shot<'a> {
    beam: &'a BeamRow,
    azimuth_rad: f64,
    sin_azimuth: f64,
    cos_azimuth: f64,
    corrected: Corrected,
}

impl<'a> Shot<'a> {
    #[inline]
    fn new(column: &Column, beam: &'a BeamRow) -> Self {
        let azimuth_rad = pixel_azimuth_rad(column, beam);
        let (sin_azimuth, cos_azimuth) = azimuth_rad.sin_cos();
        Self {
            beam,
            azimuth_rad,
            sin_azimuth,
            cos_azimuth,
            corrected: Corrected::new(beam),
        }
    }

    /// From the beam's origin to the point at a range, metres.
    #[inline]
    fn along_m(&self, range_m: f32) -> [f64; 3] {
        self.corrected
            .point_m(range_m, self.sin_azimuth, self.cos_azimuth)
    }

    /// The same from the sensor's origin.
    #[inline]
    fn point_m(&self, along_m: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = along_m;
        let sideways = f64::from(self.beam.horizontal_offset_m);
        let up = f64::from(self.beam.vertical_offset_m);
        [
            x - sideways * self.cos_azimuth,
            y + sideways * self.sin_azimuth,
            z + up,
        ]
    }

    /// Azimuth and elevation of what lies along the beam, radians.
    fn direction_rad(&self, along_m: [f64; 3]) -> [f64; 2] {
        if self.corrected.is_straight() {
            return [self.azimuth_rad, f64::from(self.beam.elevation_rad)];
        }
        let [x, y, z] = along_m;
        let azimuth_rad = x.atan2(y).rem_euclid(TAU);
        [
            if azimuth_rad < TAU { azimuth_rad } else { 0.0 },
            z.atan2(x.hypot(y)),
        ]
    }
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::*;

    const SHAPE: Shape = Shape {
        rows: 3,
        columns_capacity: 5,
        dual: true,
        segments_capacity: 2,
    };

    #[test]
    fn what_is_written_is_read_and_a_wrong_header_is_refused() {
        let mut buffer = memory(SHAPE.total_bytes());
        let bytes: &mut [u8] = buffer.as_mut_bytes();
        bytes.fill(0xA5);
        let sweep = SweepMut::create(bytes, &SHAPE).unwrap();
        sweep.range[4] = 2.0;
        sweep.label2[5] = 7;
        sweep.columns[1] = Column::measured(9, 4, 1.5, 60.0, 11);
        sweep.beams[2] = BeamRow::ideal(1, -0.25, 2304);
        sweep.header.columns = 2;
        let read = SweepRef::open(bytes).unwrap();
        assert_eq!(
            (read.range.len(), read.range[4], read.label2[5]),
            (6, 2.0, 7)
        );
        assert_eq!(
            (
                read.columns.len(),
                read.columns[1].packet,
                read.beams[2].channel
            ),
            (2, 9, 1)
        );

        assert_eq!(
            SweepRef::open(&bytes[..100]).err(),
            Some(LayoutError::Bytes { bytes: 100 })
        );
        // The tables hold arbitrary values.
        let sweep = SweepMut::open(bytes).unwrap();
        sweep.range[..6].fill(1.0);
        (
            sweep.header.time_ns,
            sweep.beams[0].shift,
            sweep.beams[1].shift,
        ) = (i64::MAX, i32::MIN, i32::MAX);
        for circular in [0, flags::CIRCULAR] {
            SweepMut::open(bytes).unwrap().header.flags = circular;
            assert!(
                SweepRef::open(bytes)
                    .unwrap()
                    .returns()
                    .all(|one| one.time_ns == i64::MAX)
            );
        }
        SweepMut::open(bytes).unwrap().header.columns = 6;
        assert_eq!(SweepRef::open(bytes).err(), Some(LayoutError::Inconsistent));
        bytes[0] = 0;
        assert_eq!(SweepRef::open(bytes).err(), Some(LayoutError::Foreign));
    }

    /// Zeros, aligned as a sweep must be.
    fn memory(bytes: usize) -> Vec<[u64; 8]> {
        vec![[0; 8]; bytes.div_ceil(64)]
    }

    /// Calls every method of a sweep, whatever it holds.
    fn ask_all(sweep: &SweepRef<'_>) {
        let (rows, columns) = (sweep.rows(), sweep.columns.len());
        assert_eq!(
            (
                sweep.range.len(),
                sweep.label.len(),
                sweep.reflectivity.len()
            ),
            (rows * columns, rows * columns, rows * columns)
        );
        assert_eq!(sweep.segments.len(), sweep.header.segments as usize);
        let header = sweep.header;
        let _ = (
            header.time_source(),
            header.return_mode(),
            header.sensor(),
            header.name(),
        );
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column)))
        {
            assert!(sweep.fired_in(row, column) < columns);
            let azimuth_rad = sweep.azimuth_rad(row, column);
            assert!(azimuth_rad.is_nan() || (0.0..TAU).contains(&azimuth_rad));
            let _ = (
                sweep.time_ns(row, column),
                sweep.point_m(row, column, f32::MAX),
            );
            let both = usize::from(!sweep.kind.is_empty());
            assert!(sweep.pixel(row, column).iter().flatten().count() <= 1 + both);
        }
        assert!(sweep.returns().count() <= rows * columns * 2);
    }

    /// A packed copy is the same sweep in no more bytes; a table that is too short is refused.
    fn pack_and_compare(sweep: &SweepRef<'_>) {
        let shape = sweep.packed_shape(sweep.segments.len());
        assert!(shape.total_bytes() <= sweep.header.total_bytes as usize);
        let mut buffer = memory(shape.total_bytes());
        sweep.pack(&shape, buffer.as_mut_bytes()).unwrap();
        let packed = SweepRef::open(buffer.as_bytes()).unwrap();
        let parts = |sweep: &SweepRef<'_>| {
            [
                sweep.range.as_bytes().to_vec(),
                sweep.reflectivity.to_vec(),
                sweep.label.as_bytes().to_vec(),
                sweep.range2.as_bytes().to_vec(),
                sweep.reflectivity2.to_vec(),
                sweep.label2.as_bytes().to_vec(),
                sweep.kind.to_vec(),
                sweep.columns.as_bytes().to_vec(),
                sweep.beams.as_bytes().to_vec(),
                sweep.segments.as_bytes().to_vec(),
                // From the model on, but for the margin.
                sweep.header.as_bytes()[124..236].to_vec(),
                sweep.header.as_bytes()[240..].to_vec(),
            ]
        };
        assert!(parts(&packed) == parts(sweep));
        assert_eq!(packed.header.margin_columns, 0);
        if let Some(fewer) = sweep.segments.len().checked_sub(1) {
            let refused = sweep.pack(&sweep.packed_shape(fewer), buffer.as_mut_bytes());
            assert_eq!(refused, Err(LayoutError::Inconsistent));
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// An arbitrary header before arbitrary bytes: no panic, and nothing out of bounds.
        #[test]
        fn a_hostile_header_does_no_harm(
            dual in any::<bool>(),
            noise in any::<u64>(),
            writes in vec((0_usize..112, prop_oneof![0_u32..12, any::<u32>(), Just(u32::MAX), Just(1 << 31)]), 0..6),
            cut in prop_oneof![4 => Just(0_usize), 1 => 1_usize..2000],
        ) {
            let shape = Shape { dual, ..SHAPE };
            let mut buffer = memory(shape.total_bytes());
            let bytes: &mut [u8] = buffer.as_mut_bytes();
            // xorshift64: planes and tables hold arbitrary values.
            let mut state = noise | 1;
            for byte in &mut *bytes {
                (state, *byte) = (state ^ state << 13, state as u8);
                state ^= state >> 7;
                state ^= state << 17;
            }
            let header = SweepMut::create(bytes, &shape).unwrap().header;
            (header.columns, header.segments) = (4, 1);
            let (header, _) = bytes.split_at_mut(size_of::<Header>());
            for (word, value) in writes {
                header[word * 4..][..4].copy_from_slice(&value.to_le_bytes());
            }
            let len = bytes.len().saturating_sub(cut);
            if let Ok(sweep) = SweepRef::open(&bytes[..len]) {
                ask_all(&sweep);
                pack_and_compare(&sweep);
            }
        }
    }

    /// By hand: azimuth 90 degrees is +x; 30 degrees up at 2 m is 1.732 m out and 1 m up.
    #[test]
    fn axes_are_those_of_the_manual() {
        let mut beam = BeamRow::ideal(0, 30_f32.to_radians(), 1_000_000);
        beam.vertical_offset_m = 0.01;
        let column = Column::measured(0, 0, 80_f32.to_radians(), 10_f32.to_radians() * 1000.0, 0);
        let [x, y, z] = pixel_point_m(&column, &beam, 2.0);
        assert!((x - 1.732_050_8).abs() < 1e-6 && y.abs() < 1e-6 && (z - 1.01).abs() < 1e-6);
    }
}
