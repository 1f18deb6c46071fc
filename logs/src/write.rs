//! Writing the project's own CSV.

use std::io::Write;

use super::formats::project::{
    ACC, ATTITUDE, CMD_HEIGHT, CMD_PITCH, CMD_ROLL, CMD_THRUST, CMD_YAW_RATE, GYRO, MARKER, SETPOINT,
    SETPOINT_YAW, TIME, TRUE_ATTITUDE, TRUE_POS, TRUE_VEL, VBAT,
};
use super::{Fixes, FlightLog, LogError, Result};

/// One column to write: its name and a way to turn the log's value into the column's unit.
pub(super) struct Column<'a> {
    pub(super) name: &'static str,
    values: &'a [f64],
    convert: fn(f64) -> f64,
    /// For marker columns: the row each value belongs to.
    rows: Option<&'a [usize]>,
}

impl FlightLog {
    /// Writes the log as a project CSV: degrees for angles, empty marker cells where no frame arrived.
    ///
    /// Numbers are written with as many digits as it takes to read the same bits back; angles, converted to
    /// degrees and back, agree to a relative 1e-12. `t_s`, commands, setpoint, marker, IMU, battery and truth
    /// survive; `vel_mps`, `onboard` and `notes` have no column.
    ///
    /// # Errors
    /// [`LogError::CannotWrite`] when a channel that the format requires is absent, has the wrong length or has a
    /// value that is not finite; [`LogError::Write`] when `out` fails.
    pub fn write_csv(&self, out: impl Write) -> Result<()> {
        let columns = self.columns()?;
        self.write_rows(&columns, out).map_err(LogError::Write)
    }

    fn write_rows(&self, columns: &[Column<'_>], out: impl Write) -> Result<(), csv::Error> {
        let mut writer = csv::Writer::from_writer(out);
        writer.write_record(columns.iter().map(|c| c.name))?;
        let mut next_fix = 0;
        for row in 0..self.len() {
            let has_fix = self.fixes.row.get(next_fix) == Some(&row);
            for column in columns {
                writer.write_field(column.cell(row, has_fix.then_some(next_fix)).unwrap_or_default())?;
            }
            writer.write_record(None::<&[u8]>)?;
            next_fix += usize::from(has_fix);
        }
        Ok(writer.flush()?)
    }

    /// The columns of the project's form, checked.
    pub(super) fn columns(&self) -> Result<Vec<Column<'_>>> {
        let mut columns = vec![plain(TIME, &self.t_s)];
        columns.extend(triple(SETPOINT, required(SETPOINT[0], &self.setpoint_m)?));
        columns.push(angle(SETPOINT_YAW, required(SETPOINT_YAW, &self.setpoint_yaw_rad)?));
        columns.push(angle(CMD_ROLL, required(CMD_ROLL, &self.cmd_roll_rad)?));
        columns.push(angle(CMD_PITCH, required(CMD_PITCH, &self.cmd_pitch_rad)?));
        columns.push(angle(CMD_YAW_RATE, required(CMD_YAW_RATE, &self.cmd_yaw_rate_radps)?));
        columns.extend(self.cmd_thrust_pwm.as_ref().map(|v| plain(CMD_THRUST, v)));
        columns.extend(self.cmd_height_m.as_ref().map(|v| plain(CMD_HEIGHT, v)));
        if self.cmd_thrust_pwm.is_none() && self.cmd_height_m.is_none() {
            return Err(invalid_channel("the vertical command (thrust or height)", "is absent"));
        }
        columns.extend(marker(&self.fixes)?);
        let [roll, pitch, yaw] = ATTITUDE;
        columns.push(angle(roll, &self.roll_rad));
        columns.push(angle(pitch, &self.pitch_rad));
        columns.push(angle(yaw, &self.yaw_rad));
        columns.extend(triple(GYRO, required(GYRO[0], &self.gyro_radps)?));
        columns.extend(triple(ACC, required(ACC[0], &self.acc_mps2)?));
        columns.push(plain(VBAT, required(VBAT, &self.vbat_v)?));
        if let Some(truth) = &self.truth {
            columns.extend(triple(TRUE_POS, &truth.pos_m));
            columns.extend(triple(TRUE_VEL, &truth.vel_mps));
            let [roll, pitch, yaw] = TRUE_ATTITUDE;
            columns.push(angle(roll, &truth.roll_rad));
            columns.push(angle(pitch, &truth.pitch_rad));
            columns.push(angle(yaw, &truth.yaw_rad));
        }
        for column in &columns {
            column.check(self.len())?;
        }
        Ok(columns)
    }
}

impl Column<'_> {
    /// The number of a row as text, `None` for a marker column in a row without a fix.
    pub(super) fn cell(&self, row: usize, fix: Option<usize>) -> Option<String> {
        let index = if self.rows.is_some() { fix? } else { row };
        self.values.get(index).map(|value| (self.convert)(*value).to_string())
    }

    /// Returns whether every row has a value.
    pub(super) fn is_dense(&self) -> bool {
        self.rows.is_none()
    }

    fn check(&self, rows: usize) -> Result<()> {
        let expected = self.rows.map_or(rows, <[usize]>::len);
        if self.values.len() != expected {
            return Err(invalid_channel(self.name, "has a different number of values than the log has rows"));
        }
        if self.values.iter().any(|v| !v.is_finite()) {
            return Err(invalid_channel(self.name, "holds a value that is not finite"));
        }
        if let Some(at) = self.rows {
            let ascending = at.windows(2).all(|pair| pair[0] < pair[1]);
            if !ascending || at.last().is_some_and(|last| *last >= rows) {
                let problem = "has fixes in rows that do not ascend or do not exist";
                return Err(invalid_channel(self.name, problem));
            }
        }
        Ok(())
    }
}

fn plain<'a>(name: &'static str, values: &'a [f64]) -> Column<'a> {
    Column { name, values, convert: |v| v, rows: None }
}

fn angle<'a>(name: &'static str, values: &'a [f64]) -> Column<'a> {
    Column { convert: f64::to_degrees, ..plain(name, values) }
}

fn triple<'a>(names: [&'static str; 3], values: &'a [Vec<f64>; 3]) -> impl Iterator<Item = Column<'a>> {
    names.into_iter().zip(values).map(|(name, values)| plain(name, values))
}

fn marker(fixes: &Fixes) -> Result<Vec<Column<'_>>> {
    let [x, y, z, yaw, t] = MARKER;
    let mut columns: Vec<Column<'_>> = triple([x, y, z], &fixes.pos_m).collect();
    columns.push(angle(yaw, required(yaw, &fixes.yaw_rad)?));
    columns.push(plain(t, &fixes.capture_t_s));
    for column in &mut columns {
        column.rows = Some(&fixes.row);
    }
    Ok(columns)
}

fn required<'a, T>(name: &str, channel: &'a Option<T>) -> Result<&'a T> {
    channel.as_ref().ok_or_else(|| invalid_channel(name, "is absent"))
}

fn invalid_channel(channel: &str, reason: &'static str) -> LogError {
    LogError::CannotWrite { channel: channel.to_owned(), reason }
}
