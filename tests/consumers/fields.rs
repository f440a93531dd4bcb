//! The fields and numbers of the layout as the Rust types have them. What is private there is
//! padding.

use std::mem::{offset_of, size_of};

use sweepd::publish::Preamble;
use sweepd::sweep::layout::{
    self, BeamRow, Column, ColumnStatus, Header, Part, ReturnChoice, ReturnKind, SECOND_BLOCKS,
    Segment, TimeSource, flags,
};
use sweepd::sweep::objects::{OBJECTS_VERSION, Object, ObjectsHeader, flags as told, why};
use sweepd::wire::data::ReturnMode;

/// A struct of the layout.
pub struct Struct {
    /// Name on the page.
    pub name: &'static str,
    /// Name in C.
    pub c_name: &'static str,
    pub bytes: usize,
    pub fields: Vec<Field>,
}

/// A public field.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    pub name: &'static str,
    pub offset: usize,
    pub bytes: usize,
    /// `u32`, or `f32[3]`, or the name of a struct on the page.
    pub kind: String,
}

fn field<S, T>(name: &'static str, offset: usize, _of: fn(&S) -> &T) -> Field {
    let kind = std::any::type_name::<T>()
        .trim_start_matches('[')
        .trim_end_matches(']');
    let kind = kind.split_once("; ").map_or_else(
        || kind.rsplit("::").next().unwrap_or(kind).to_owned(),
        |(element, count)| format!("{element}[{count}]"),
    );
    Field {
        name,
        offset,
        bytes: size_of::<T>(),
        kind,
    }
}

macro_rules! of {
    ($type:ty, $c_name:literal: $($field:ident)*) => {
        Struct {
            name: stringify!($type),
            c_name: $c_name,
            bytes: size_of::<$type>(),
            fields: vec![$(field::<$type, _>(stringify!($field), offset_of!($type, $field), |it| &it.$field)),*],
        }
    };
}

/// All of them.
pub fn structs() -> Vec<Struct> {
    let before = [of!(Preamble, "sweepd_preamble": layout_version sweep_bytes)];
    let of_sweeps = before.into_iter().chain(structs_of_sweeps());
    of_sweeps.chain(structs_of_objects()).collect()
}

/// What messages of objects are made of.
fn structs_of_objects() -> [Struct; 2] {
    [
        of!(ObjectsHeader, "sweepd_objects_header":
            magic version header_bytes sequence run_ns time_ns sent_ns sent_monotonic_ns time_source flags objects
            first_ordinal labels first_label position_m yaw_rad pitch_rad roll_rad name),
        of!(Object, "sweepd_object":
            segment first_pixel ordinal why azimuth_first_rad azimuth_last_rad first_ns last_ns),
    ]
}

/// What sweeps are made of.
pub fn structs_of_sweeps() -> [Struct; 4] {
    [
        of!(Header, "sweepd_header":
            magic version header_bytes total_bytes offsets rows columns columns_capacity segments segments_capacity model
            return_mode return_choice flags time_source sequence time_ns duration_ns sensor_time_ns arrival_ns rpm
            cut_azimuth_rad height_m pitch_rad roll_rad missing_columns lost_packets packets returns ground decode_ns
            ground_ns label_ns margin_columns unfired_columns dropped_datagrams yaw_rad position_m completed_ns
            completed_monotonic_ns run_ns sensor name),
        of!(Column, "sweepd_column": packet azimuth_rad azimuth_rate_rad_s time_ns block status),
        of!(BeamRow, "sweepd_beam":
            channel elevation_rad rotation_rad time_offset_ns vertical_offset_m horizontal_offset_m shift distance_offset_m
            distance_offset_x_m distance_offset_y_m),
        of!(Segment, "sweepd_segment":
            label points min_m max_m centroid_m nearest_m row_first row_last column_first column_last),
    ]
}

/// The numbers that have a name in every language.
pub fn numbers() -> Vec<(&'static str, u64)> {
    let of_objects = [
        ("OBJECTS_VERSION", OBJECTS_VERSION),
        ("OBJECTS_LAST", told::LAST),
        ("OBJECTS_NO_HEIGHT", told::NO_HEIGHT),
        ("OBJECTS_PARTIAL", told::PARTIAL),
        ("WHY_COMPLETE", why::COMPLETE),
        ("WHY_SWEEP", why::SWEEP),
        ("WHY_WIDE", why::WIDE),
        ("WHY_SEAM", why::SEAM),
    ];
    let of_objects = of_objects.map(|(name, value)| (name, value.into()));
    numbers_of_sweeps().into_iter().chain(of_objects).collect()
}

/// Those of sweeps.
pub fn numbers_of_sweeps() -> Vec<(&'static str, u64)> {
    vec![
        ("LAYOUT_VERSION", layout::LAYOUT_VERSION.into()),
        ("ALIGN", layout::ALIGN as u64),
        ("PARTIAL", flags::PARTIAL.into()),
        ("CIRCULAR", flags::CIRCULAR.into()),
        ("REVERSED", flags::REVERSED.into()),
        ("BLANKED", flags::BLANKED.into()),
        ("RATE_UNSTABLE", flags::RATE_UNSTABLE.into()),
        ("STOPPED", flags::STOPPED.into()),
        ("HEIGHT_ESTIMATED", flags::HEIGHT_ESTIMATED.into()),
        ("LOSS_ESTIMATED", flags::LOSS_ESTIMATED.into()),
        ("LABEL_NONE", layout::LABEL_NONE.into()),
        ("LABEL_GROUND", layout::LABEL_GROUND.into()),
        ("LABEL_FIRST_SEGMENT", layout::LABEL_FIRST_SEGMENT.into()),
        ("TIME_HOST", TimeSource::Host as u64),
        ("TIME_GPS", TimeSource::Gps as u64),
        ("MODE_STRONGEST", ReturnMode::Strongest.byte().into()),
        ("MODE_LAST", ReturnMode::Last.byte().into()),
        ("MODE_DUAL", ReturnMode::Dual.byte().into()),
        ("CHOICE_NEAREST", ReturnChoice::Nearest as u64),
        ("CHOICE_STRONGEST", ReturnChoice::Strongest as u64),
        ("CHOICE_LAST", ReturnChoice::Last as u64),
        ("COLUMN_MEASURED", ColumnStatus::Measured as u64),
        ("COLUMN_MISSING", ColumnStatus::Missing as u64),
        ("COLUMN_UNFIRED", ColumnStatus::Unfired as u64),
        ("KIND_STRONGEST", ReturnKind::Strongest as u64),
        ("KIND_LAST", ReturnKind::Last as u64),
        ("KIND_SECOND_BLOCKS", SECOND_BLOCKS.into()),
        ("PART_RANGE", Part::Range as u64),
        ("PART_REFLECTIVITY", Part::Reflectivity as u64),
        ("PART_LABEL", Part::Label as u64),
        ("PART_RANGE2", Part::Range2 as u64),
        ("PART_REFLECTIVITY2", Part::Reflectivity2 as u64),
        ("PART_LABEL2", Part::Label2 as u64),
        ("PART_KIND", Part::Kind as u64),
        ("PART_COLUMNS", Part::Columns as u64),
        ("PART_BEAMS", Part::Beams as u64),
        ("PART_SEGMENTS", Part::Segments as u64),
    ]
}
