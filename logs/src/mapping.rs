//! Mapping files: which column of a log is which channel of a flight, in which unit, sign and frame.
//!
//! ```toml
//! frame = "z-up"                # or "ned" (x forward, z down), or "crazyflie" (the firmware's signs)
//! position = "motion_capture"   # or "camera", "estimate"
//! [time]
//! column = "stamp"
//! unit = "ms"
//! [channels]
//! x = { column = "px", unit = "mm" }
//! cmd_pitch = { column = "theta_ref", unit = "deg", sign = -1 }
//! ```

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use toml::Spanned;

use crate::columns::closest;
use crate::front::TableLayout;
use crate::quantity::{CHANNELS, Channel, ERPM, FRAMES, Quantity};
use crate::times::{TIME_UNITS, TimeSpec};
use crate::{AttitudeSource, LogError, PositionSource, Result, text};

/// One column of a file as a channel.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Source {
    pub(crate) channel: Channel,
    pub(crate) column: String,
    pub(crate) unit: &'static str,
    /// From the file's unit, scale, sign and frame to the log's.
    pub(crate) factor: f64,
    /// Added before, in the file's unit.
    pub(crate) offset: f64,
    /// Thrust of all motors in newton per unit of the column, where it is a force.
    pub(crate) force_n: Option<f64>,
    /// A time column of its own, in the unit of the file's.
    pub(crate) time: Option<String>,
}

/// A checked mapping file.
#[derive(Debug, Clone, PartialEq)]
pub struct Mapping {
    pub(crate) layout: TableLayout,
    pub(crate) time: TimeSpec,
    pub(crate) position: Option<PositionSource>,
    pub(crate) attitude: Option<AttitudeSource>,
    pub(crate) airborne_above_m: Option<f64>,
    /// The body of a recording that has several.
    pub(crate) body: Option<String>,
    /// Factors on channels, whatever format read them.
    pub(crate) scale: Vec<(&'static str, f64)>,
    pub(crate) sources: Vec<Source>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    frame: Option<Spanned<String>>,
    position: Option<PositionSource>,
    attitude: Option<AttitudeSource>,
    airborne_above_m: Option<Spanned<f64>>,
    body: Option<String>,
    /// For a thrust command in m/s2.
    mass_kg: Option<f64>,
    /// For rotor speeds in erpm.
    pole_pairs: Option<f64>,
    #[serde(default)]
    table: TableLayout,
    #[serde(default)]
    time: Time,
    /// Factors on channels of the log, after it was read.
    #[serde(default)]
    scale: BTreeMap<String, Spanned<f64>>,
    channels: Option<BTreeMap<String, Spanned<Entry>>>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
struct Time {
    column: Option<String>,
    unit: Option<Spanned<String>>,
    rate_hz: Option<Spanned<f64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    column: String,
    unit: Option<Spanned<String>>,
    sign: Option<Spanned<i64>>,
    scale: Option<Spanned<f64>>,
    offset: Option<Spanned<f64>>,
    frame: Option<Spanned<String>>,
    time: Option<String>,
}

impl Mapping {
    /// Reads a mapping file.
    ///
    /// # Errors
    /// [`LogError::Io`], and as [`Mapping::parse`].
    pub fn read(path: &Path) -> Result<Self> {
        let file = path.display().to_string();
        let bytes = text::load(path, &file, text::LIMIT_MIB)?;
        let Ok(content) = String::from_utf8(bytes) else { return Err(LogError::NotText { file }) };
        Self::parse(&file, &content)
    }

    /// Checks the text of a mapping file; `file` is its name in errors. Without `[channels]` it gives only the layout
    /// of a table, or corrections.
    ///
    /// # Errors
    /// [`LogError::BadMapping`] names the file, the line and what was expected there; an unknown name gets the one
    /// that is spelled most alike.
    pub fn parse(file: &str, content: &str) -> Result<Self> {
        let place = Place { file, content };
        let read = toml::from_str::<File>(content);
        let raw = read.map_err(|error| {
            place.bad(error.span().map_or(0, |span| span.start), error.message().to_owned())
        })?;
        let mut sources = Vec::new();
        let has_channels = raw.channels.is_some();
        for (name, entry) in raw.channels.unwrap_or_default() {
            sources.push(place.source(&name, entry, raw.frame.as_ref(), [raw.mass_kg, raw.pole_pairs])?);
        }
        if let Some(above) = raw.airborne_above_m.as_ref().filter(|above| !above.get_ref().is_finite()) {
            return Err(
                place.bad(above.span().start, "airborne_above_m: expected a finite height".to_owned())
            );
        }
        let unit = |unit: &Spanned<String>| {
            let known = TIME_UNITS.iter().find(|known| known.name == unit.get_ref()).copied();
            known.ok_or_else(|| place.unknown(unit, "unit of time", &TIME_UNITS.map(|unit| unit.name)))
        };
        if let Some(rate) = raw.time.rate_hz.as_ref().filter(|rate| !(0.1..1e5).contains(rate.get_ref())) {
            return Err(
                place.bad(rate.span().start, "rate_hz: expected 0.1 to 100000 rows per second".to_owned())
            );
        }
        let scale = raw.scale.into_iter().map(|(name, factor)| place.scale(&name, &factor));
        let mapping = Self {
            layout: raw.table,
            time: TimeSpec {
                column: raw.time.column,
                unit: raw.time.unit.as_ref().map(unit).transpose()?,
                rate_hz: raw.time.rate_hz.map(Spanned::into_inner),
            },
            position: raw.position,
            attitude: raw.attitude,
            airborne_above_m: raw.airborne_above_m.map(Spanned::into_inner),
            body: raw.body,
            scale: scale.collect::<Result<_>>()?,
            sources,
        };
        if has_channels {
            mapping.check_groups(&place)?;
        }
        Ok(mapping)
    }

    /// The mapping that belongs to a log: `flight.mapping.toml` beside `flight.csv`, or `mapping.toml` for all
    /// logs of a folder.
    pub fn path_beside(log: &Path) -> Option<PathBuf> {
        let name = log.file_name()?.to_string_lossy().into_owned();
        let stem = name.strip_suffix(".gz").unwrap_or(&name);
        let stem = stem.rsplit_once('.').map_or(stem, |(stem, _)| stem);
        let candidates =
            [log.with_file_name(format!("{stem}.mapping.toml")), log.with_file_name("mapping.toml")];
        candidates.into_iter().find(|path| path.is_file())
    }

    pub(crate) fn source(&self, channel: &str) -> Option<&Source> {
        self.sources.iter().find(|source| source.channel.name == channel)
    }

    /// The columns that are mapped.
    pub(crate) fn columns(&self) -> Vec<&str> {
        let times = self.sources.iter().filter_map(|source| source.time.as_deref());
        self.sources.iter().map(|source| source.column.as_str()).chain(times).collect()
    }

    /// A position is needed, and what belongs together has to be there together.
    fn check_groups(&self, place: &Place<'_>) -> Result<()> {
        for channel in CHANNELS.iter() {
            let begun = channel.group == "position"
                || self.sources.iter().any(|source| source.channel.group == channel.group);
            if begun && self.source(channel.name).is_none() {
                let others: Vec<&str> =
                    CHANNELS.iter().filter(|c| c.group == channel.group).map(|c| c.name).collect();
                let needed = if channel.group == "position" { "every flight needs" } else { "go together" };
                let problem =
                    format!("channel \"{}\" is not mapped: {} {needed}", channel.name, others.join(", "));
                return Err(place.bad(place.content.len().saturating_sub(1), problem));
            }
        }
        Ok(())
    }
}

/// A mapping file while it is checked, for errors.
struct Place<'a> {
    file: &'a str,
    content: &'a str,
}

impl Place<'_> {
    fn bad(&self, byte: usize, problem: String) -> LogError {
        let before = &self.content.as_bytes()[..byte.min(self.content.len())];
        let line = before.iter().filter(|b| **b == b'\n').count() as u64 + 1;
        LogError::BadMapping { file: self.file.to_owned(), line, problem }
    }

    fn unknown(&self, found: &Spanned<String>, kind: &str, known: &[&str]) -> LogError {
        self.bad(found.span().start, unknown(found.get_ref(), kind, known))
    }

    /// A factor on a channel of the log.
    fn scale(&self, name: &str, factor: &Spanned<f64>) -> Result<(&'static str, f64)> {
        let offset = factor.span().start;
        let all: Vec<&str> = crate::scale::CHANNELS.split(' ').collect();
        let Some(known) = all.iter().find(|known| **known == name) else {
            return Err(self.bad(offset, unknown(name, "channel to scale", &all)));
        };
        let factor = *factor.get_ref();
        if !factor.is_finite() || factor == 0.0 {
            return Err(self.bad(offset, format!("scale of {name}: expected a finite number other than 0")));
        }
        Ok((*known, factor))
    }

    /// The channel that a file's is in its frame, and its sign.
    fn in_frame(&self, channel: Channel, frame: Option<&Spanned<String>>) -> Result<(Channel, f64)> {
        let Some(frame) = frame else { return Ok((channel, channel.signs[0])) };
        let position = FRAMES.iter().position(|known| known == frame.get_ref());
        let index = position.ok_or_else(|| self.unknown(frame, "frame", &FRAMES))?;
        Ok(channel.signs.get(index).map_or_else(|| channel.in_y_up(), |sign| (channel, *sign)))
    }

    /// The source that an entry describes.
    fn source(
        &self,
        name: &str,
        entry: Spanned<Entry>,
        of_file: Option<&Spanned<String>>,
        [mass_kg, pole_pairs]: [Option<f64>; 2],
    ) -> Result<Source> {
        let start = entry.span().start;
        let entry = entry.into_inner();
        let Some(channel) = CHANNELS.iter().copied().find(|channel| channel.name == name) else {
            let known: Vec<&str> = CHANNELS.iter().map(|channel| channel.name).collect();
            return Err(self.bad(start, unknown(name, "channel", &known)));
        };
        let units = channel.quantity.units();
        let (unit, scale) = match &entry.unit {
            None => units[0],
            Some(unit) => {
                let known: Vec<&str> = units.iter().map(|(name, _)| *name).collect();
                let listed = units.iter().find(|(name, _)| name == unit.get_ref()).copied();
                listed.ok_or_else(|| self.unknown(unit, &format!("unit of {name}"), &known))?
            }
        };
        let (channel, turned) = self.in_frame(channel, entry.frame.as_ref().or(of_file))?;
        let sign = match &entry.sign {
            None => 1.0,
            Some(sign) if sign.get_ref().abs() == 1 => *sign.get_ref() as f64,
            Some(sign) => {
                return Err(self.bad(
                    sign.span().start,
                    format!("sign of {name}: found {}, expected 1 or -1", sign.get_ref()),
                ));
            }
        };
        let finite = |number: &Option<Spanned<f64>>, word: &str, otherwise: f64| match number {
            Some(number) if number.get_ref().is_finite() => Ok(*number.get_ref()),
            Some(number) => {
                Err(self.bad(number.span().start, format!("{word} of {name}: expected a finite number")))
            }
            None => Ok(otherwise),
        };
        let (more, offset) = (finite(&entry.scale, "scale", 1.0)?, finite(&entry.offset, "offset", 0.0)?);
        let needed = |number: Option<f64>, word: &str| {
            let number = number.filter(|number| number.is_finite() && *number > 0.0);
            number.ok_or_else(|| {
                self.bad(start, format!("{name} in {unit} needs {word} at the top of the mapping"))
            })
        };
        let force_n = match (channel.quantity, unit) {
            (Quantity::Pwm, "N") => Some(1.0),
            (Quantity::Pwm, "m/s2") => Some(needed(mass_kg, "mass_kg")?),
            _ => None,
        };
        let more = if unit == ERPM { more / needed(pole_pairs, "pole_pairs")? } else { more };
        // one of four motors carries a quarter
        let force_n = force_n.map(|force_n| if channel.group == "motors" { 4.0 * force_n } else { force_n });
        let factor = more * scale * sign * turned;
        Ok(Source { channel, column: entry.column, unit, factor, offset, force_n, time: entry.time })
    }
}

/// Words for a name that is none of the known ones.
fn unknown(found: &str, kind: &str, known: &[&str]) -> String {
    match closest(found, known) {
        Some(alike) => format!("unknown {kind} \"{found}\": did you mean \"{alike}\"?"),
        None => format!("unknown {kind} \"{found}\": expected one of {}", known.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::quantity::DEG_RAD;

    const POSITION: &str =
        "[channels]\nx = { column = \"a\" }\ny = { column = \"b\" }\nz = { column = \"c\" }\n";

    fn problem(more: &str) -> String {
        Mapping::parse("lab.toml", &format!("[time]\ncolumn = \"t\"\n{POSITION}{more}"))
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn what_is_unknown_is_refused_where_it_stands_with_a_proposal() {
        let cases = [
            (
                "cmd_rol = { column = \"r\" }",
                "line 7: unknown channel \"cmd_rol\": did you mean \"cmd_roll\"?",
            ),
            (
                "vbat = { column = \"r\", unit = \"mVs\" }",
                "line 7: unknown unit of vbat \"mVs\": did you mean \"mV\"?",
            ),
            ("yaw = { column = \"r\", unit = \"turns\" }", "expected one of rad, deg"),
            (
                "yaw = { column = \"r\", frame = \"nedd\" }",
                "line 7: unknown frame \"nedd\": did you mean \"ned\"?",
            ),
            ("yaw = { column = \"r\", sign = 2 }", "line 7: sign of yaw: found 2, expected 1 or -1"),
            ("roll = { column = \"r\" }", "channel \"pitch\" is not mapped: roll, pitch go together"),
            ("yaw = { colum = \"r\" }", "line 7: unknown field `colum`"),
            ("yaw = ", "line 7"),
        ];
        for (more, expected) in cases {
            let message = problem(more);
            assert!(message.contains("lab.toml") && message.contains(expected), "{message}");
        }
        let message =
            Mapping::parse("lab.toml", "[time]\ncolumn = \"t\"\n[channels]\n").unwrap_err().to_string();
        assert!(message.contains("x, y, z every flight needs"), "{message}");
    }

    #[test]
    fn frames_units_and_signs_make_one_factor() {
        let text = format!(
            "frame = \"ned\"\n[time]\ncolumn = \"t\"\n{POSITION}pitch = {{ column = \"p\", unit = \"deg\", sign = -1 }}\nroll = {{ column = \"r\" }}\ncmd_yaw_rate = {{ column = \"w\", frame = \"z-up\" }}\n"
        );
        let mapping = Mapping::parse("lab.toml", &text).unwrap();
        let factor = |name: &str| mapping.source(name).unwrap().factor;
        assert_eq!([factor("x"), factor("y"), factor("z"), factor("roll")], [1.0, -1.0, -1.0, 1.0]);
        assert_eq!([factor("pitch"), factor("cmd_yaw_rate")], [DEG_RAD, -1.0]);
    }

    #[test]
    fn the_page_lists_every_channel_unit_and_frame() {
        let page = include_str!("../../docs/logs.md");
        let units = CHANNELS
            .iter()
            .filter(|c| c.quantity != Quantity::Time)
            .flat_map(|c| c.quantity.units())
            .map(|(unit, _)| *unit);
        for name in CHANNELS.iter().map(|c| c.name).chain(units).chain(FRAMES) {
            assert!(page.contains(&format!("`{name}`")), "{name} is not on the page");
        }
    }
}
