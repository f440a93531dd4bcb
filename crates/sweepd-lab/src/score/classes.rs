//! The classes of SemanticKITTI that are scored.

/// Points without a class.
pub(super) const UNLABELLED: u16 = 0;
/// Points that no surface made.
pub(super) const OUTLIER: u16 = 1;
/// Trees and bushes, which are not instances.
pub(super) const VEGETATION: u16 = 70;
/// Ground that is not paved.
pub(super) const TERRAIN: u16 = 72;

/// The class of a true label.
pub(super) fn class_of(label: u32) -> u16 {
    label as u16
}

/// Road, parking, pavement, other ground, lane marking, terrain.
pub(super) fn is_ground(class: u16) -> bool {
    matches!(class, 40 | 44 | 48 | 49 | 60 | TERRAIN)
}

/// Vehicles, people and riders, standing (10 to 32) and moving (252 to 259).
pub(super) fn is_thing(class: u16) -> bool {
    matches!(class, 10 | 11 | 13 | 15 | 16 | 18 | 20 | 30..=32 | 252..=259)
}

/// Whether a true label is that of a single instance.
pub(super) fn is_instance(label: u32) -> bool {
    is_thing(class_of(label)) && label >> 16 != 0
}
