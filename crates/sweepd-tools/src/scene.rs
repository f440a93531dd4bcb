//! The option `--scene` of `simulate` and `view`.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use sweepd_lab::simulate::Setting;

/// Reads the name of a scene; help and completions have all of them.
pub(crate) fn scene() -> impl TypedValueParser<Value = Setting> {
    let names =
        Setting::ALL.map(|setting| PossibleValue::new(setting.name()).help(setting.about()));
    PossibleValuesParser::new(names).try_map(|name| {
        let mut settings = Setting::ALL.into_iter();
        settings
            .find(|setting| setting.name() == name)
            .ok_or("no scene")
    })
}
