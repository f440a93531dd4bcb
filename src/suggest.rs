//! "Did you mean ...?"

use strsim::osa_distance;

/// Longest word that is compared: the names of keys are shorter.
const LONGEST: usize = 40;

/// The word among the quoted ones of `expected` ("one of `a`, `b`") that was meant by `found`, if
/// one is near.
pub fn suggestion<'a>(found: &str, expected: &'a str) -> Option<&'a str> {
    nearest(
        found.trim_matches(['"', '\'']),
        expected.split('`').skip(1).step_by(2),
    )
}

/// The word that was meant by `found`, if one is near: it begins with `found` (a unit is missing),
/// or at most a third of its letters are wrong.
pub fn nearest<'a>(found: &str, words: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    if found.is_empty() || found.len() > LONGEST {
        return None;
    }
    words
        .map(|word| (difference(found, word), word))
        .filter(|(difference, word)| *difference <= word.len().div_ceil(3))
        .min_by_key(|&(difference, _)| difference)
        .map(|(_, word)| word)
}

/// How much `found` differs from a word: not at all where only the unit is missing.
fn difference(found: &str, word: &str) -> usize {
    match word.strip_prefix(found) {
        Some(rest) if rest.starts_with('_') => 0,
        _ => osa_distance(found, word),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_word_is_meant_and_a_strange_one_is_not_guessed() {
        let keys = "expected one of `name`, `port`, `position_port`, `theta_deg`";
        assert_eq!(suggestion("prot", keys), Some("port"));
        assert_eq!(suggestion("theta", keys), Some("theta_deg"));
        assert_eq!(suggestion("'postion_port'", keys), Some("position_port"));
        assert_eq!(suggestion("colour", keys), None);
        assert_eq!(suggestion("", keys), None);
        assert_eq!(suggestion("port", "expected a whole number"), None);
    }
}
