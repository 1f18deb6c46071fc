//! Pictures of a flight.

use crazyflie_env::vector::state_index;
use crazyflie_picture::{
    BLACK, BLUE, Drawing, Drone, Film, GREEN, Marker, ORANGE, PALETTE, Panel, Path3, PictureError, Scene,
    Style, VERMILION, chart, path3d, render,
};

use super::{Trace, TraceRow, log};

/// Half the side of the marker (thesis 2.2): over it is "over the marker".
const MARKER_M: f64 = 0.0985;

/// Positions, poses by the camera, and commands over time.
pub fn picture(trace: &Trace, title: &str) -> Result<Drawing, PictureError> {
    let flight = log(trace);
    let (t, fixes) = (&flight.t_s, &flight.fixes);
    let degrees = |values: &[f64]| values.iter().map(|v| v.to_degrees()).collect::<Vec<_>>();
    let panel = |y_label: &str| Panel::new("time (s)", y_label);
    let mut panels = Vec::new();
    for (i, label) in ["x (m)", "y (m)", "z (m)"].into_iter().enumerate() {
        let mut position =
            panel(label).curve(Style::Dashed, BLACK, "set-point", t, trace.observation_column(16 + i));
        // fixes at every tick say nothing
        if fixes.row.len() < flight.len() && !fixes.row.is_empty() {
            position =
                position.curve(Style::Points, ORANGE, "marker fixes", &fixes.capture_t_s, &fixes.pos_m[i]);
        }
        position = position.curve(Style::Solid, BLUE, "vehicle", t, trace.state(i));
        if i < 2 {
            position = position.band(GREEN, "over the marker", [-MARKER_M, MARKER_M]);
        }
        panels.push(position);
    }
    panels.push(
        panel("yaw (deg)")
            .curve(Style::Dashed, BLACK, "set-point", t, degrees(&trace.observation_column(19)))
            .curve(Style::Solid, BLUE, "vehicle", t, degrees(&trace.state(8))),
    );
    for (label, angle, command) in
        [("pitch (deg)", 7, &flight.cmd_pitch_rad), ("roll (deg)", 6, &flight.cmd_roll_rad)]
    {
        let mut tilt = panel(label);
        if let Some(command) = command {
            tilt = tilt.curve(Style::Step, VERMILION, "command", t, degrees(command));
        }
        panels.push(tilt.curve(Style::Solid, BLUE, "vehicle", t, degrees(&trace.state(angle))));
    }
    let thrust = flight.cmd_thrust_pwm.as_ref().map(|pwm| ("thrust (PWM counts)", pwm));
    let height = flight.cmd_height_m.as_ref().map(|height_m| ("commanded height (m)", height_m));
    if let (Some(_), Some((label, lift))) = (&flight.cmd_pitch_rad, thrust.or(height)) {
        panels.push(panel(label).curve(Style::Step, VERMILION, "command", t, lift));
    } else {
        let rows: Vec<_> =
            trace.rows.iter().map(|row| trace.interface.set_point(&row.action.map(f64::from))).collect();
        let channels = trace.interface.level().entry().channels.iter().enumerate();
        panels.push(channels.fold(panel("set-points of actions"), |panel, (i, channel)| {
            panel.curve(Style::Step, PALETTE[i], channel.name, t, rows.iter().map(|row| row[i]))
        }));
    }
    let velocities = ["vx", "vy", "vz"].into_iter().zip(3..).zip(PALETTE);
    panels.push(velocities.fold(panel("velocity (m/s)"), |panel, ((name, i), color)| {
        panel.curve(Style::Solid, color, name, t, trace.state(i))
    }));
    chart(&panels, 2, title)
}

/// The way through space.
pub fn path(trace: &Trace, title: &str) -> Result<Drawing, PictureError> {
    let wanted = trace.rows.iter().map(|row| [16, 17, 18].map(|k| f64::from(row.observation[k]))).collect();
    let paths = [
        Path3 { label: "set-point".into(), points_m: wanted, style: Style::Dashed, color: BLACK },
        Path3 { label: "vehicle".into(), points_m: way(trace), style: Style::Solid, color: BLUE },
    ];
    path3d(&paths, &trace.outlines, title)
}

/// Frames of a film, and how many pixels they have.
const FRAMES_PER_S: u16 = 20;
const FRAME_PX: [u16; 2] = [480, 360];
/// Seconds that a trail lasts.
const TRAIL_S: f64 = 4.0;

/// The vehicles with their tilt, as the flights went.
pub fn film(traces: &[Trace]) -> Result<Film, PictureError> {
    let tick_s = traces.first().map_or(1.0, |trace| trace.tick_s);
    let ticks = traces.iter().map(|trace| trace.rows.len()).max().unwrap_or(0);
    let [width, height] = FRAME_PX;
    let frames = (0..).map(|frame| (f64::from(frame) / f64::from(FRAMES_PER_S) / tick_s).round() as usize);
    let frames = frames.take_while(|tick| *tick < ticks).map(|tick| {
        let mut pixels = vec![0; usize::from(width) * usize::from(height) * 3];
        draw_frame(traces, tick, (TRAIL_S / tick_s) as usize, &mut pixels).map(|()| pixels)
    });
    Ok(Film { width, height, frames_per_s: FRAMES_PER_S, frames: frames.collect::<Result<_, _>>()? })
}

fn draw_frame(traces: &[Trace], tick: usize, trail: usize, pixels: &mut [u8]) -> Result<(), PictureError> {
    let flown = |trace: &Trace| tick.min(trace.rows.len().saturating_sub(1));
    // a crashed drone lies at its place of impact
    let now = traces.iter().filter_map(|trace| trace.rows.get(flown(trace)));
    let place = |row: &TraceRow| [0, 1, 2].map(|i| row.state[state_index::POS + i]);
    let drone = |(row, color): (&TraceRow, [u8; 3])| {
        let [roll_rad, pitch_rad, yaw_rad] =
            [state_index::ROLL, state_index::PITCH, state_index::YAW].map(|i| row.state[i]);
        Drone { pos_m: place(row), roll_rad, pitch_rad, yaw_rad, color }
    };
    let drones: Vec<_> = now.clone().zip(PALETTE.into_iter().cycle()).map(drone).collect();
    let setpoints_m: Vec<_> = now.map(|row| [0, 1, 2].map(|i| row.setpoint()[i])).collect();
    let trails: Vec<Vec<_>> = traces
        .iter()
        .map(|trace| {
            trace.rows.iter().take(flown(trace)).skip(flown(trace).saturating_sub(trail)).map(place).collect()
        })
        .collect();
    let trails_m: Vec<&[_]> = trails.iter().map(Vec::as_slice).collect();
    let markers = &[Marker::default()];
    let scene = Scene {
        drones: &drones,
        trails_m: &trails_m,
        setpoints_m: &setpoints_m,
        markers,
        ..Scene::default()
    };
    let [width, height] = FRAME_PX;
    render(&scene, width.into(), height.into(), pixels)
}

/// Positions of a drone.
pub(super) fn way(trace: &Trace) -> Vec<[f64; 3]> {
    trace.rows.iter().map(|row| [0, 1, 2].map(|i| f64::from(row.state[i]))).collect()
}
