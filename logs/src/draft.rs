//! Drafts of mapping files for CSVs of unknown layout, guessed from column names and values.

use crazyflie_statistics::quantile;
use std::fmt::Write;
use std::path::Path;

use crate::inspect::{Inspection, SignCheck, SignVerdict, is_angle_ratio};
use crate::mapping::Mapping;
use crate::names::{self, Guess, channel_of};
use crate::quantity::{CHANNELS, Channel, Quantity};
use crate::reader::{binary_reader, columns, text_table};
use crate::table::NUMBER;
use crate::text::{self, NamedFile};
use crate::{FlightLog, LogError, ReadOptions, Result};

/// A drafted mapping file.
#[derive(Debug, Clone)]
pub struct Draft {
    /// TOML with comments.
    pub text: String,
    /// The flight that it makes of the file, or why it does not suffice yet.
    pub log: Result<FlightLog, String>,
    /// Channels whose unit is a guess that neither the file nor the motion confirms, with that unit.
    pub guesses: Vec<String>,
}

/// One column that was taken for a channel.
struct Entry {
    channel: Channel,
    column: String,
    unit: &'static str,
    /// Low, median and high value, as logged.
    range: [f64; 3],
    /// Why this unit.
    reason: Reason,
    flipped: Option<&'static str>,
}

/// Evidence for the unit of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reason {
    Said,
    /// Its size, or that of its family.
    Size,
    Motion,
}

/// The columns of a log while a mapping is drafted.
struct Source {
    /// The `[table]` and `[time]` parts of the mapping.
    clock: String,
    /// Names, units if the file gives them, and values; none of a column that is not all numbers.
    columns: Vec<(String, Option<String>, Option<Vec<f64>>)>,
}

impl Draft {
    /// Drafts a mapping for a log. Signs and units that the flight itself contradicts are mended.
    ///
    /// # Errors
    /// [`LogError`] if the files cannot be read, or have no columns of numbers with a time.
    pub fn of_log(path: &Path) -> Result<Self> {
        let (files, _) = text::load_all(path, text::LIMIT_MIB, &mut Vec::new())?;
        Self::from_files(&files)
    }

    /// Drafts a mapping for the bytes of a file.
    ///
    /// # Errors
    /// The errors of [`Draft::of_log`].
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self> {
        Self::from_files(&text::unpack(file, bytes, text::LIMIT_MIB, &mut Vec::new())?)
    }

    fn from_files(files: &[NamedFile]) -> Result<Self> {
        let source = Source::new(files)?;
        let (mut entries, rest) = entries(&source);
        set_units(&mut entries);
        let frame = frame(&entries);
        let read = |text: &str| {
            let mapping = Mapping::parse("the draft", text)?;
            FlightLog::from_files(files, mapping)
        };
        if let Ok(log) = read(&write(&source, frame, &entries, &rest)) {
            let checks = Inspection::from_log(&log).signs;
            mend_units(&mut entries, &checks);
            turn_signs(&mut entries, &checks);
        }
        let text = write(&source, frame, &entries, &rest);
        let log = read(&text).map_err(|error| error.to_string());
        let is_guess = |entry: &&Entry| entry.reason == Reason::Size;
        let guesses =
            entries.iter().filter(is_guess).map(|entry| format!("{} ({})", entry.channel.name, entry.unit));
        Ok(Self { text, log, guesses: guesses.collect() })
    }
}

impl Source {
    fn new(files: &[NamedFile]) -> Result<Self> {
        if let [NamedFile { name, bytes }, ..] = files
            && binary_reader(bytes).is_some()
        {
            let columns =
                columns(name, bytes)?.0.into_iter().map(|series| (series.name, None, Some(series.values)));
            return Ok(Self { clock: String::new(), columns: columns.collect() });
        }
        let table = text_table(files, None, &ReadOptions::default(), &mut Vec::new())?;
        if table.has_no_header {
            return Err(LogError::NoHeader { file: table.file });
        }
        let clock = table.clock()?;
        let (time, unit) = (quote(&clock.column), quote(clock.unit.name));
        let is_other = |column: &&String| **column != clock.column;
        let values = |column: &String| table.cells(column, NUMBER).ok().map(|(_, values)| values);
        let columns = table.header.iter().filter(is_other);
        let columns = columns.map(|name| (name.clone(), table.unit(name).map(str::to_owned), values(name)));
        let clock = || format!("[time]\ncolumn = {time}\nunit = {unit}\n\n");
        let clock = if files.len() > 1 { String::new() } else { clock() };
        Ok(Self { clock, columns: columns.collect() })
    }
}

/// The best column for each channel, and the columns that are left with their ranges.
fn entries(source: &Source) -> (Vec<Entry>, Vec<String>) {
    let mut best: Vec<(Guess, Entry)> = Vec::new();
    let mut rest = Vec::new();
    for (column, said, values) in &source.columns {
        let Some(values) = values else {
            rest.push(format!("{column}: not all numbers"));
            continue;
        };
        let range = [0.01, 0.5, 0.99].map(|share| quantile(values, share).unwrap_or(0.0));
        let shown = || format!("{column}: {:.4} to {:.4}", range[0], range[2]);
        let guessed = channel_of(column).and_then(|guess| {
            let channel = CHANNELS.iter().copied().find(|c| c.name == guess.channel)?;
            Some((guess, channel))
        });
        let Some((guess, channel)) = guessed.filter(|_| !values.is_empty()) else {
            rest.push(shown());
            continue;
        };
        let units = channel.quantity.units();
        let word = said.as_deref().map_or(guess.unit.clone(), names::unit_of);
        let named = units.iter().find(|(unit, _)| word.as_deref() == Some(*unit)).map(|(unit, _)| *unit);
        let reason = if named.is_some() { Reason::Said } else { Reason::Size };
        let unit = named.unwrap_or(units[0].0);
        let entry = Entry { channel, column: column.clone(), unit, range, reason, flipped: None };
        match best.iter_mut().find(|(_, known)| known.channel.name == channel.name) {
            None => best.push((guess, entry)),
            Some((known, old)) if guess.score > known.score => {
                rest.push(format!(
                    "{}: {:.4} to {:.4}, or {} instead",
                    old.column, old.range[0], old.range[2], channel.name
                ));
                (*known, *old) = (guess, entry);
            }
            Some(_) => rest.push(format!("{}, or {} instead", shown(), channel.name)),
        }
    }
    let mut entries: Vec<Entry> = best.into_iter().map(|(_, entry)| entry).collect();
    take_estimate_for_position(&mut entries);
    // An incomplete group of channels is left to the user.
    let is_whole = |group: &str, entries: &[Entry]| {
        let needed = CHANNELS.iter().filter(|c| c.group == group);
        needed.clone().all(|c| entries.iter().any(|entry| entry.channel.name == c.name))
    };
    let (whole, part): (Vec<bool>, Vec<&Entry>) =
        entries.iter().map(|e| (is_whole(e.channel.group, &entries), e)).unzip();
    let lone = part.iter().zip(&whole).filter(|(_, whole)| !**whole);
    rest.extend(lone.map(|(e, _)| format!("{}: {} without the others", e.column, e.channel.name)));
    let mut keep = whole.into_iter();
    entries.retain(|entry| keep.next() == Some(true) || entry.channel.group == "position");
    entries.sort_by_key(|entry| CHANNELS.iter().position(|c| c.name == entry.channel.name));
    (entries, rest)
}

/// Uses the vehicle's estimate as the position, if nothing outside measured it.
fn take_estimate_for_position(entries: &mut [Entry]) {
    if entries.iter().any(|entry| entry.channel.group == "position") {
        return;
    }
    for entry in entries.iter_mut().filter(|entry| entry.channel.group == "position estimate") {
        let name = entry.channel.name.trim_start_matches("estimate_");
        entry.channel = CHANNELS.iter().copied().find(|c| c.name == name).unwrap_or(entry.channel);
    }
}

/// Channels that one person logs in one unit.
fn family(channel: Channel) -> &'static str {
    match (channel.quantity, channel.group) {
        (Quantity::Angle, "tilt" | "yaw") => "angles",
        (Quantity::Angle, _) => "commands",
        (_, group) => group,
    }
}

/// Gives every column its family's unit, else the one in which the family's values are a small vehicle's.
fn set_units(entries: &mut [Entry]) {
    let mut known: Vec<(&str, &'static str, bool)> = Vec::new();
    for at in 0..entries.len() {
        let of = family(entries[at].channel);
        if known.iter().any(|(family, ..)| *family == of) {
            continue;
        }
        let members: Vec<&Entry> = entries.iter().filter(|entry| family(entry.channel) == of).collect();
        let said = members.iter().find(|entry| entry.reason == Reason::Said).map(|entry| entry.unit);
        let guessed = || members.iter().find_map(|entry| unit_of_size(entry));
        let as_measured = || {
            let angles = known.iter().find(|(family, ..)| of == "commands" && *family == "angles");
            angles.map(|(_, unit, _)| *unit)
        };
        let unit =
            said.or_else(guessed).or_else(as_measured).unwrap_or(members[0].channel.quantity.units()[0].0);
        known.push((of, unit, said.is_some()));
    }
    for entry in entries.iter_mut().filter(|entry| entry.reason != Reason::Said) {
        let of = family(entry.channel);
        if let Some((_, unit, said)) = known.iter().find(|(family, ..)| *family == of) {
            entry.unit = unit;
            entry.reason = if *said { Reason::Said } else { Reason::Size };
        }
    }
}

/// Infers the unit from the size of a column's values; `None` if ours is as likely.
fn unit_of_size(entry: &Entry) -> Option<&'static str> {
    let (channel, [low, median, high]) = (entry.channel, entry.range);
    let size = low.abs().max(high.abs());
    Some(match channel.quantity {
        // Rooms are at most 50 m.
        Quantity::Length if size > 5000.0 || (size > 50.0 && channel.group == "position") => "mm",
        Quantity::Speed if size > 100.0 => "mm/s",
        // A small vehicle tilts by less than 45 degrees; a yaw wraps at half a turn or is counted on.
        Quantity::Angle if size > if channel.name.ends_with("yaw") { 3.3 } else { 0.8 } => "deg",
        Quantity::Rate if channel.group == "rotor speeds" && size > 2500.0 => "rpm",
        Quantity::Rate if channel.group != "rotor speeds" && size > 12.0 => "deg/s",
        Quantity::Acceleration if channel.name == "acc_z" && (0.5..2.0).contains(&median.abs()) => "g",
        Quantity::Acceleration if size > 200.0 => "mg",
        Quantity::Pwm if size <= 1.01 => "fraction",
        Quantity::Pwm if size <= 100.5 => "percent",
        Quantity::Pwm if size <= 255.5 => "pwm8",
        Quantity::Voltage if size > 100.0 => "mV",
        _ => return None,
    })
}

/// Mends the units that the flight contradicts by a factor of 57, and marks those that it confirms.
fn mend_units(entries: &mut [Entry], checks: &[SignCheck]) {
    let families: Vec<(&str, Option<f64>)> = checks
        .iter()
        .filter_map(|check| {
            let channel = CHANNELS.iter().copied().find(|c| c.name == check.channel)?;
            Some((family(channel), check.unit_ratio()))
        })
        .collect();
    for entry in entries.iter_mut().filter(|entry| entry.reason == Reason::Size) {
        let of = family(entry.channel);
        let mut seen = families.iter().filter(|(family, _)| *family == of).filter_map(|(_, ratio)| *ratio);
        let Some(ratio) = seen.next() else { continue };
        entry.reason = Reason::Motion;
        entry.unit = match entry.unit {
            "deg" if is_angle_ratio(ratio) => "rad",
            "deg/s" if is_angle_ratio(ratio) => "rad/s",
            "rad" if is_angle_ratio(1.0 / ratio) => "deg",
            "rad/s" if is_angle_ratio(1.0 / ratio) => "deg/s",
            unit => unit,
        };
    }
}

/// NED, if the height is negative nearly always; y up, if y and not z is what rises from one place.
fn frame(entries: &[Entry]) -> &'static str {
    let range = |name: &str| entries.iter().find(|entry| entry.channel.name == name).map(|entry| entry.range);
    let rises = |range: Option<[f64; 3]>| {
        range.is_some_and(|[low, median, high]| {
            median - low > RISEN_SHARE * (high - low) && -low < FLOOR_SHARE * high
        })
    };
    let sinks = |[low, median, high]: [f64; 3]| median < 0.0 && -low > 3.0 * high.max(0.0);
    if range("z").is_some_and(sinks) {
        "ned"
    } else if !rises(range("z")) && rises(range("y")) {
        "y-up"
    } else {
        "z-up"
    }
}

/// A flight is longer in the air than on the floor, and the floor is near zero.
const RISEN_SHARE: f64 = 0.3;
const FLOOR_SHARE: f64 = 0.1;

/// Turns the signs that the flight contradicts. An attitude is first: commands and gyro are checked against it.
fn turn_signs(entries: &mut [Entry], checks: &[SignCheck]) {
    let contradicted = |name: &str| {
        checks.iter().find(|check| check.channel == name && check.verdict == SignVerdict::Contradicts)
    };
    let (roll, pitch) = (contradicted("roll").is_some(), contradicted("pitch").is_some());
    for entry in entries {
        let name = entry.channel.name;
        // A command that follows a wrong angle is wrong with it.
        let with_angle = match name {
            "cmd_roll" | "gyro_x" => roll,
            "cmd_pitch" | "gyro_y" => pitch,
            _ => false,
        };
        let check = contradicted(name);
        if check.is_some() != with_angle {
            entry.flipped = Some(
                check.map_or("goes with the measured angle, whose sign the flight contradicts", |check| {
                    check.expectation
                }),
            );
        }
    }
}

fn write(source: &Source, frame: &str, entries: &[Entry], rest: &[String]) -> String {
    let mut text = format!(
        "# Draft, guessed from names and values: check every line. Save it as NAME.mapping.toml beside NAME.csv, or as\n\
         # mapping.toml for all logs of a folder; every command then reads them.\n\
         frame = {}  # z-up (x forward, y left), ned (z down), y-up or crazyflie (the firmware's signs); also per channel\n\
         # position = \"motion_capture\"  # or camera, estimate; guessed from its rate unless said\n\
         # attitude = \"imu\"  # or motion_capture, marker\n\n{}[channels]\n",
        quote(frame),
        source.clock,
    );
    for entry in entries {
        let sign = if entry.flipped.is_some() { ", sign = -1" } else { "" };
        let [low, _, high] = entry.range;
        let why = entry.flipped.map_or(String::new(), |why| format!("; turned: {why}"));
        let how = match entry.reason {
            Reason::Said => "",
            Reason::Size => "; the unit is a guess that nothing checks",
            Reason::Motion => "; the motion confirms the unit",
        };
        let (name, column, unit) = (entry.channel.name, quote(&entry.column), quote(entry.unit));
        let _ = writeln!(
            text,
            "{name} = {{ column = {column}, unit = {unit}{sign} }}  # {low:.4} to {high:.4}{how}{why}"
        );
    }
    for channel in
        CHANNELS.iter().filter(|c| c.group == "position" && !entries.iter().any(|e| e.channel.name == c.name))
    {
        let _ = writeln!(text, "# {} = {{ column = \"?\", unit = \"m\" }}  # needed", channel.name);
    }
    if !rest.is_empty() {
        let _ = writeln!(text, "\n# Columns without a channel:");
        rest.iter().for_each(|line| {
            let _ = writeln!(text, "#   {}", line.chars().filter(|c| !c.is_control()).collect::<String>());
        });
        let names: Vec<&str> = CHANNELS.iter().map(|channel| channel.name).collect();
        let _ = writeln!(text, "# Channels: {}", names.join(", "));
    }
    text
}

/// A TOML string.
fn quote(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}
