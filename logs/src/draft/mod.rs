//! Drafts of mapping files for CSVs of unknown layout, guessed from column names and values.

mod words;

use crazyflie_statistics::quantile;
use std::fmt::Write;

use crate::inspect::{Inspection, SignVerdict};
use crate::mapping::{CHANNELS, Channel, Mapping, Quantity};
use crate::table::{NUMBER, Table};
use crate::times::{guess_unit, time_column};
use crate::{FlightLog, LogError, text};

use words::{Guess, channel_of};

/// A drafted mapping file.
#[derive(Debug, Clone)]
pub struct Draft {
    /// TOML with comments.
    pub text: String,
    /// The flight that it makes of the file, or why it does not suffice yet.
    pub log: Result<FlightLog, String>,
}

/// One column that was taken for a channel.
struct Entry {
    channel: Channel,
    column: String,
    unit: &'static str,
    /// Low, median and high value, as logged.
    range: [f64; 3],
    flipped: Option<&'static str>,
}

impl Draft {
    /// Drafts a mapping for the bytes of a CSV. Signs that the flight itself contradicts are turned.
    ///
    /// # Errors
    /// [`LogError`] if the bytes are no table of text.
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self, LogError> {
        let mut notes = Vec::new();
        let unpacked = text::decompress(file, bytes, &mut notes)?;
        let table = Table::parse(file, &unpacked, &mut notes)?;
        let time = time_column(&table.header)
            .or(table.header.first().map(String::as_str))
            .unwrap_or_default()
            .to_owned();
        let (mut entries, rest) = entries(&table, &time);
        let frame = frame(&entries);
        let read = |text: &str| {
            let mapping = Mapping::parse("the draft", text)?;
            FlightLog::from_mapped_bytes(file, bytes, mapping)
        };
        let text = write(&table, &time, frame, &entries, &rest);
        if let Ok(log) = read(&text) {
            turn_signs(&mut entries, &log);
        }
        let text = write(&table, &time, frame, &entries, &rest);
        let log = read(&text).map_err(|error| error.to_string());
        Ok(Self { text, log })
    }
}

/// The best column for each channel, and the columns that are left with their ranges.
fn entries(table: &Table, time: &str) -> (Vec<Entry>, Vec<String>) {
    let mut best: Vec<(Guess, Entry)> = Vec::new();
    let mut rest = Vec::new();
    for column in table.header.iter().filter(|column| *column != time) {
        let Ok((_, values)) = table.cells(column, NUMBER) else {
            rest.push(format!("{column}: not all numbers"));
            continue;
        };
        let range = [0.01, 0.5, 0.99].map(|share| quantile(&values, share).unwrap_or(0.0));
        let shown = || format!("{column}: {:.4} to {:.4}", range[0], range[2]);
        let found = channel_of(column).and_then(|guess| {
            let channel = CHANNELS.into_iter().find(|c| c.name == guess.channel)?;
            Some((guess, channel))
        });
        let Some((guess, channel)) = found.filter(|_| !values.is_empty()) else {
            rest.push(shown());
            continue;
        };
        let unit = unit(&guess, channel, range);
        let entry = Entry { channel, column: column.clone(), unit, range, flipped: None };
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
    // What goes together and is not there together is left to the user.
    let is_whole = |group: &str, entries: &[Entry]| {
        let needed = CHANNELS.iter().filter(|c| c.group == group);
        needed.clone().all(|c| entries.iter().any(|entry| entry.channel.name == c.name))
    };
    let (whole, part): (Vec<bool>, Vec<&Entry>) =
        entries.iter().map(|e| (is_whole(e.channel.group, &entries), e)).unzip();
    rest.extend(
        part.iter()
            .zip(&whole)
            .filter(|(_, whole)| !**whole)
            .map(|(e, _)| format!("{}: {} without the others", e.column, e.channel.name)),
    );
    let mut keep = whole.into_iter();
    entries.retain(|entry| keep.next() == Some(true) || entry.channel.group == "position");
    entries.sort_by_key(|entry| CHANNELS.iter().position(|c| c.name == entry.channel.name));
    (entries, rest)
}

/// The unit that the name says, else the one in which the values are a small vehicle's.
fn unit(guess: &Guess, channel: Channel, [low, median, high]: [f64; 3]) -> &'static str {
    let units = channel.quantity.units();
    if let Some((unit, _)) = units.iter().find(|(unit, _)| guess.unit.as_deref() == Some(*unit)) {
        return unit;
    }
    let size = low.abs().max(high.abs());
    match channel.quantity {
        // Rooms are at most 50 m.
        Quantity::Length if size > 5000.0 || (size > 50.0 && channel.group == "position") => "mm",
        Quantity::Speed if size > 100.0 => "mm/s",
        // A small vehicle tilts by less than 45 degrees; a yaw wraps at half a turn or is counted on.
        Quantity::Angle if size > if channel.name.ends_with("yaw") { 3.3 } else { 0.8 } => "deg",
        Quantity::Rate if channel.group == "rotor speeds" && size > 2500.0 => "rpm",
        Quantity::Rate if channel.group != "rotor speeds" && size > 12.0 => "deg/s",
        Quantity::Acceleration if channel.name == "acc_z" && (0.5..2.0).contains(&median.abs()) => "g",
        Quantity::Acceleration if size > 200.0 => "mg",
        // The axes without gravity: below half of it, in multiples of g.
        Quantity::Acceleration if channel.name != "acc_z" && size < 1.0 => "g",
        Quantity::Pwm if size <= 1.01 => "fraction",
        Quantity::Pwm if size <= 100.5 => "percent",
        Quantity::Pwm if size <= 255.5 => "pwm8",
        Quantity::Voltage if size > 100.0 => "mV",
        _ => units[0].0,
    }
}

/// NED, if the height is negative nearly always.
fn frame(entries: &[Entry]) -> &'static str {
    let height = entries.iter().find(|entry| entry.channel.name == "z");
    if height.is_some_and(|z| z.range[1] < 0.0 && -z.range[0] > 3.0 * z.range[2].max(0.0)) {
        "ned"
    } else {
        "z-up"
    }
}

/// Turns the signs that the flight contradicts. An attitude comes first: commands and gyro are checked
/// against it.
fn turn_signs(entries: &mut [Entry], log: &FlightLog) {
    let checks = Inspection::from_log(log).signs;
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

fn write(table: &Table, time: &str, frame: &str, entries: &[Entry], rest: &[String]) -> String {
    let times = table.cells(time, NUMBER).map_or(Vec::new(), |(_, values)| values);
    let mut text = format!(
        "# Draft, guessed from names and values: check every line. Save it as NAME.mapping.toml beside NAME.csv, or as\n\
         # mapping.toml for all CSVs of a folder; every command then reads them.\n\
         frame = {}  # z-up (x forward, y left), ned (z down) or crazyflie (the firmware's signs); also per channel\n\
         # position = \"motion_capture\"  # or camera, estimate; guessed from its rate unless said\n\
         # attitude = \"imu\"  # or motion_capture, marker\n\n\
         [time]\ncolumn = {}\nunit = {}\n\n[channels]\n",
        quote(frame),
        quote(time),
        quote(guess_unit(&times).name),
    );
    for entry in entries {
        let sign = if entry.flipped.is_some() { ", sign = -1" } else { "" };
        let [low, _, high] = entry.range;
        let why = entry.flipped.map_or(String::new(), |why| format!("; turned: {why}"));
        let (name, column, unit) = (entry.channel.name, quote(&entry.column), quote(entry.unit));
        let _ = writeln!(
            text,
            "{name} = {{ column = {column}, unit = {unit}{sign} }}  # {low:.4} to {high:.4}{why}"
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
