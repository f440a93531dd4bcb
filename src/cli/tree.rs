//! What a program tells of its command line, so that another can complete it.

use clap::builder::PossibleValue;
use clap::{Arg, ArgAction, Command};
use serde::{Deserialize, Serialize};

/// A command and those below it.
#[derive(Debug, Deserialize, Serialize)]
pub struct Tree {
    /// Its name.
    pub name: String,
    about: String,
    options: Vec<Opt>,
    /// The commands below it.
    pub commands: Vec<Tree>,
}

/// An option or an argument.
#[derive(Debug, Deserialize, Serialize)]
struct Opt {
    id: String,
    long: Option<String>,
    short: Option<char>,
    help: String,
    takes_value: bool,
    values: Vec<String>,
}

impl Tree {
    /// That of a command.
    pub fn of(command: &Command) -> Self {
        let options = command.get_arguments().filter(|arg| !arg.is_hide_set());
        let commands = command.get_subcommands().filter(|sub| !sub.is_hide_set());
        Self {
            name: command.get_name().to_owned(),
            about: command
                .get_about()
                .map(ToString::to_string)
                .unwrap_or_default(),
            options: options.map(Opt::of).collect(),
            commands: commands.map(Self::of).collect(),
        }
    }

    /// A command with these names.
    pub fn command(&self) -> Command {
        Command::new(self.name.clone())
            .about(self.about.clone())
            .args(self.options.iter().map(Opt::arg))
            .subcommands(self.commands.iter().map(Self::command))
    }
}

impl Opt {
    fn of(arg: &Arg) -> Self {
        let values = arg.get_possible_values();
        Self {
            id: arg.get_id().to_string(),
            long: arg.get_long().map(str::to_owned),
            short: arg.get_short(),
            help: arg.get_help().map(ToString::to_string).unwrap_or_default(),
            takes_value: arg.get_action().takes_values(),
            values: values
                .iter()
                .map(|value| value.get_name().to_owned())
                .collect(),
        }
    }

    fn arg(&self) -> Arg {
        let mut arg = Arg::new(self.id.clone()).help(self.help.clone());
        if let Some(long) = &self.long {
            arg = arg.long(long.clone());
        }
        if let Some(short) = self.short {
            arg = arg.short(short);
        }
        if !self.takes_value {
            return arg.action(ArgAction::SetTrue);
        }
        if self.long.is_none() && self.short.is_none() {
            arg = arg.action(ArgAction::Append);
        }
        if !self.values.is_empty() {
            let values: Vec<PossibleValue> = self.values.iter().map(PossibleValue::new).collect();
            arg = arg.value_parser(values);
        }
        arg
    }
}
