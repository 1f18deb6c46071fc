//! State of a drone that packets read and write: tables, parameters, log blocks, memory, orders for the next tick. A
//! link locks it for as long as a packet takes; the simulation locks it to take orders and to show a tick,
//! never while it steps.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, LazyLock};

use tokio::sync::Notify;
use tokio::sync::mpsc::Sender;

use crate::high_level::read_request;
use crate::log_blocks::LogBlocks;
use crate::logs::LOGS;
use crate::order::{Order, PilotSettings};
use crate::packet::{Fields, MAX_DATA, Packet};
use crate::params::{PARAMS, ParamValues, index};
use crate::setpoint::{GenericSetpoint, attitude, generic, heading_rad};
use crate::supervisor::{bit, words};
use crate::telemetry::Telemetry;
use crate::toc::{Toc, TocLine};
use crate::trajectory_memory::TrajectoryMemory;

/// Orders that wait for a tick; of a flood the oldest set-points are forgotten.
const MAX_ORDERS: usize = 256;
/// From 12 on the supervisor has a port of its own.
const PROTOCOL_VERSION: u8 = 12;
/// The radio chip, as its boot loader is addressed.
const NRF_TARGET: u8 = 0xfe;
const ENOENT: u8 = 2;
/// Bit of a parameter in the table that has an extended type, and the only such type: its value may be stored.
const EXTENDED: u8 = 0x10;
const PERSISTENT: u8 = 1;
/// In lock-step, a port of our own: "go on until then", in milliseconds, which is answered with the time when it has
/// come.
const CLOCK_PORT: u8 = 10;

static PARAM_TOC: LazyLock<Toc> = LazyLock::new(|| {
    let bit = |is_set: bool, bit: u8| if is_set { bit } else { 0 };
    let line = |p: &crate::Param| TocLine {
        code: p.kind.param_code() | bit(p.read_only, 0x40) | bit(p.persistent, EXTENDED),
        name: p.name,
    };
    Toc::new(PARAMS.iter().map(line).collect(), &[])
});

static LOG_TOC: LazyLock<Toc> = LazyLock::new(|| {
    let line = |log: &crate::LogVariable| TocLine { code: log.kind.log_code(), name: log.name };
    // the most packets and operations
    Toc::new(LOGS.iter().map(line).collect(), &[16, 128])
});

/// The simulation's clock where clients drive it.
struct ClientClock {
    now_ms: u32,
    /// The client has asked for time since it came: without it there is no tick any more.
    is_driven: bool,
    /// Until when the client lets time go on.
    until_ms: Option<u32>,
    changed: Arc<Notify>,
}

impl ClientClock {
    fn forget(&mut self) {
        (self.is_driven, self.until_ms) = (false, None);
        self.changed.notify_one();
    }
}

/// One drone as packets see it.
pub(crate) struct Board {
    params: ParamValues,
    /// Stored values by the parameters' places in the table: they survive a restart.
    stored: BTreeMap<usize, f64>,
    /// Settings that follow from the parameters: derived when one is written, not in every tick.
    settings: PilotSettings,
    blocks: LogBlocks,
    memory: TrajectoryMemory,
    group_mask: u8,
    /// With the times at which they arrive.
    orders: VecDeque<(u32, Order)>,
    /// Logs on their way to the client, with the times at which they arrive.
    leaving: VecDeque<(u32, Packet)>,
    /// In lock-step.
    clock: Option<ClientClock>,
    /// In lock-step: how long orders and logs are on their way.
    latency_ms: u32,
    /// Telemetry of the last tick.
    shown: Telemetry,
    /// Channel of packets that answer no request.
    sink: Option<Sender<Packet>>,
    /// A link has a client that is heard.
    taken: bool,
    /// A client came since the last tick.
    came: bool,
    index: usize,
    /// Name of the vehicle's model.
    vehicle: String,
    /// Parameters of the decks that are on.
    decks: Vec<&'static str>,
}

impl Board {
    /// In lock-step `clock` is told of what clients ask for.
    pub(crate) fn new(
        index: usize,
        vehicle: &str,
        decks: Vec<&'static str>,
        clock: Option<Arc<Notify>>,
        latency_ms: u32,
    ) -> Self {
        let params = ParamValues::new();
        let mut board = Board {
            settings: PilotSettings::new(&params),
            params,
            stored: BTreeMap::new(),
            blocks: LogBlocks::default(),
            memory: TrajectoryMemory::new(),
            group_mask: 0,
            orders: VecDeque::new(),
            leaving: VecDeque::new(),
            clock: clock.map(|changed| ClientClock { now_ms: 0, is_driven: false, until_ms: None, changed }),
            latency_ms,
            shown: Telemetry::default(),
            sink: None,
            taken: false,
            came: false,
            index,
            vehicle: vehicle.to_owned(),
            decks,
        };
        board.begin();
        board
    }

    /// Parameters of a vehicle that was just switched on.
    fn begin(&mut self) {
        self.params = ParamValues::new();
        self.stored.iter().for_each(|(id, value)| self.params.set_value(*id, *value));
        self.params.set("cpu.id0", self.index as f64);
        self.decks.iter().for_each(|deck| self.params.set(deck, 1.0));
        self.settings = PilotSettings::new(&self.params);
        (self.blocks, self.memory, self.group_mask) = (LogBlocks::default(), TrajectoryMemory::new(), 0);
    }

    /// A client comes, whose logs go to `sink`: refused while another one is heard.
    pub(crate) fn claim(&mut self, sink: &Sender<Packet>) -> bool {
        let free = !self.taken;
        if free {
            (self.taken, self.came, self.sink) = (true, true, Some(sink.clone()));
            self.leaving.clear();
            // a client learns why its vehicle does not fly
            self.tell_change(words(0, self.shown.info & (bit::IS_LOCKED | bit::IS_TUMBLED)));
        }
        free
    }

    /// The client of `sink` is heard no more: another one may come, and until then logs still go to it.
    pub(crate) fn release(&mut self, sink: &Sender<Packet>) {
        if self.sink.as_ref().is_some_and(|own| own.same_channel(sink)) {
            self.taken = false;
        }
    }

    /// The client of `sink` is gone.
    pub(crate) fn disconnect(&mut self, sink: &Sender<Packet>) {
        if self.sink.as_ref().is_some_and(|own| own.same_channel(sink)) {
            (self.taken, self.sink) = (false, None);
            self.clock.iter_mut().for_each(ClientClock::forget);
        }
    }

    /// Orders since the last tick, and what the parameters say.
    pub(crate) fn take_orders(&mut self) -> (VecDeque<Order>, PilotSettings) {
        let now_ms = self.now_ms();
        let arrived = self.orders.partition_point(|(due_ms, _)| *due_ms <= now_ms);
        (self.orders.drain(..arrived).map(|(_, order)| order).collect(), self.settings)
    }

    /// Returns whether clients drive the clock.
    pub(crate) fn is_in_lockstep(&self) -> bool {
        self.clock.is_some()
    }

    /// Returns whether the client waits for the next tick; nothing where no client drives the clock.
    pub(crate) fn waits_for_tick(&self) -> Option<bool> {
        self.clock.as_ref().filter(|clock| clock.is_driven).map(|clock| clock.until_ms.is_some())
    }

    fn now_ms(&self) -> u32 {
        self.clock.as_ref().map_or(0, |clock| clock.now_ms)
    }

    /// Says two things: a client is heard, and it came since the last call.
    pub(crate) fn take_visit(&mut self) -> (bool, bool) {
        (self.taken, std::mem::take(&mut self.came))
    }

    /// Says that a client wants all drones back on their places, once.
    pub(crate) fn take_reset(&mut self) -> bool {
        let asked = self.params.get("sim.reset") != 0.0;
        if asked {
            self.params.set("sim.reset", 0.0);
        }
        asked
    }

    fn tell_change(&mut self, words: Option<&str>) {
        let stopped = self.shown.info & (bit::IS_LOCKED | bit::IS_TUMBLED) != 0;
        words.into_iter().for_each(|words| self.say(words, stopped));
    }

    /// Text on the client's console, which takes thirty bytes at a time, and on the terminal: by default where the
    /// vehicle does not fly.
    fn say(&mut self, words: &str, is_warning: bool) {
        if is_warning {
            tracing::warn!(drone = self.index, "{words}");
        } else {
            tracing::info!(drone = self.index, "{words}");
        }
        if self.sink.is_none() {
            return;
        }
        let now_ms = self.now_ms();
        for part in format!("SUP: {words}\n").as_bytes().chunks(MAX_DATA) {
            self.leaving.push_back((now_ms + self.latency_ms, Packet::new(0, 0, part)));
        }
    }

    /// The newest tick: kept for requests, and sent where blocks are due.
    pub(crate) fn show(&mut self, telemetry: Telemetry) {
        // a vehicle that was just switched on changes nothing
        let told = words(self.shown.info, telemetry.info).filter(|_| self.shown.tick_s > 0.0);
        self.shown = Telemetry { connected: self.taken, ..telemetry.seen_by(&self.decks) };
        self.tell_change(told);
        if let Some(refusal) = telemetry.request.and_then(|request| request.refusal(telemetry.info)) {
            self.say(&refusal, true);
        }
        if let Some(clock) = &mut self.clock {
            clock.now_ms = telemetry.time_ms + (1e3 * telemetry.tick_s).round() as u32;
        }
        let now_ms = self.now_ms();
        let Board { blocks, shown, sink, leaving, clock, latency_ms, .. } = self;
        let Some(sink) = sink else { return };
        blocks.send_due(shown, |packet| leaving.push_back((now_ms + *latency_ms, packet)));
        while let Some((_, packet)) = leaving.pop_front_if(|(due_ms, _)| *due_ms <= now_ms) {
            // a client that does not read loses logs: nothing waits for it
            let _ = sink.try_send(packet);
        }
        let reached = clock.as_mut().and_then(|clock| clock.until_ms.take_if(|until_ms| *until_ms <= now_ms));
        if reached.is_some() {
            let _ = sink.try_send(Packet::new(CLOCK_PORT, 0, &now_ms.to_le_bytes()));
        }
    }

    fn order(&mut self, order: Order) {
        if self.orders.len() == MAX_ORDERS {
            let streamed = self.orders.iter().position(|(_, order)| order.is_streamed());
            self.orders.remove(streamed.unwrap_or(0));
        }
        self.orders.push_back((self.now_ms() + self.latency_ms, order));
    }

    /// Carries out a packet; its answer, if it has one. Unknown set-points are ignored, as in the firmware.
    pub(crate) fn receive(&mut self, packet: &Packet) -> Option<Packet> {
        let data = packet.data();
        if packet.is_null() {
            self.power(data);
            return Some(*packet);
        }
        let answer = match (packet.port, packet.channel) {
            (2, 0) => PARAM_TOC.answer(data),
            (2, 1) => self.read_param(data),
            (2, 2) => self.write_param(data),
            (2, 3) => self.param_extras(data),
            (3, 0) => self.commander(data),
            (4, 0) => self.memory.info(data),
            (4, 1) => self.memory.read(data),
            (4, 2) => self.memory.write(data),
            (5, 0) => LOG_TOC.answer(data),
            (5, 1) => self.blocks.control(data, self.shown.time_ms),
            (6, 0) => self.position(data),
            (6, 1) => self.localization(data),
            (7, 0) => self.generic(data),
            (7, 1) => self.meta(data),
            (8, _) => self.high_level(data),
            (9, 0) => self.supervisor_info(data),
            (9, 1) => self.supervise(data),
            (CLOCK_PORT, 0) => self.answer_clock(data),
            (13, 0) => self.platform(data),
            (13, 1) => self.version(data),
            (15, 0) => Some(data.to_vec()),
            (15, 1) => Some(b"Bitcraze Crazyflie simulator".to_vec()),
            _ => None,
        }?;
        Some(Packet::new(packet.port, packet.channel, &answer))
    }

    fn read_param(&self, data: &[u8]) -> Option<Vec<u8>> {
        let id = Fields(data).u16()?;
        let mut answer = id.to_le_bytes().to_vec();
        match PARAMS.get(usize::from(id)) {
            Some(param) => {
                answer.push(0);
                param.kind.write(self.params.value(id.into()), &mut answer);
            }
            None => answer.push(ENOENT),
        }
        Some(answer)
    }

    fn write_param(&mut self, data: &[u8]) -> Option<Vec<u8>> {
        let mut fields = Fields(data);
        let id = fields.u16()?;
        let Some(param) = PARAMS.get(usize::from(id)) else {
            return Some([&id.to_le_bytes()[..], &[ENOENT]].concat());
        };
        if param.read_only {
            return None;
        }
        let value = param.kind.read(fields.rest())?;
        self.set_param(id.into(), value);
        let mut answer = id.to_le_bytes().to_vec();
        param.kind.write(self.params.value(id.into()), &mut answer);
        Some(answer)
    }

    fn set_param(&mut self, id: usize, value: f64) {
        self.params.set_value(id, value);
        self.settings = PilotSettings::new(&self.params);
        match PARAMS[id].name {
            "kalman.resetEstimation" if value != 0.0 => self.order(Order::ResetEstimator),
            "stabilizer.stop" if value != 0.0 => self.order(Order::Emergency),
            _ => {}
        }
    }

    /// By name, and what tables do not say: types, defaults, and values that survive a restart.
    fn param_extras(&mut self, data: &[u8]) -> Option<Vec<u8>> {
        let mut fields = Fields(data);
        let command = fields.u8()?;
        if command == 0 {
            return self.write_by_name(data);
        }
        let id = fields.u16()?;
        let mut answer = [&[command][..], &id.to_le_bytes()].concat();
        let place = usize::from(id);
        let param = PARAMS.get(place);
        match (command, param) {
            (2, Some(param)) => answer.push(u8::from(param.persistent) * PERSISTENT),
            (7, Some(param)) => answer.extend([0, u8::from(param.persistent) * PERSISTENT]),
            (3, Some(param)) if param.persistent => {
                self.stored.insert(place, self.params.value(place));
                answer.push(0);
            }
            (4, Some(param)) if param.persistent => {
                let stored = self.stored.get(&place);
                answer.push(u8::from(stored.is_some()));
                [Some(&param.default), stored]
                    .into_iter()
                    .flatten()
                    .for_each(|v| param.kind.write(*v, &mut answer));
            }
            (5, Some(param)) if param.persistent => {
                self.stored.remove(&place);
                answer.push(0);
            }
            (6, Some(param)) => param.kind.write(param.default, &mut answer),
            (8, Some(param)) => {
                answer.push(0);
                param.kind.write(param.default, &mut answer);
            }
            (2..=8, _) => answer.push(ENOENT),
            _ => return None,
        }
        Some(answer)
    }

    /// Group, name, kind, value; group and name end with a zero.
    fn write_by_name(&mut self, data: &[u8]) -> Option<Vec<u8>> {
        let mut parts = data[1..].splitn(3, |byte| *byte == 0);
        let (group, name, rest) = (parts.next()?, parts.next()?, parts.next()?);
        let named = [group, b".", name].concat();
        let id = std::str::from_utf8(&named).ok().and_then(index);
        let (code, value) = rest.split_first()?;
        let known = id.filter(|id| PARAMS[*id].kind.param_code() == *code && !PARAMS[*id].read_only);
        let set = known.and_then(|id| Some((id, PARAMS[id].kind.read(value)?)));
        if let Some((id, value)) = set {
            self.set_param(id, value);
        }
        let status = if set.is_some() { 0 } else { ENOENT };
        let names = &data[..data.len() - rest.len()];
        Some([names, &[status]].concat())
    }

    fn commander(&mut self, data: &[u8]) -> Option<Vec<u8>> {
        let setpoint = attitude(Fields(data))?;
        self.order(Order::Attitude(setpoint));
        None
    }

    fn generic(&mut self, data: &[u8]) -> Option<Vec<u8>> {
        let order = match generic(Fields(data))? {
            GenericSetpoint::Stop => Order::Stop,
            GenericSetpoint::Fly(setpoint) => Order::Fly(setpoint),
            GenericSetpoint::Manual(setpoint) => Order::Manual(setpoint),
        };
        self.order(order);
        None
    }

    fn meta(&mut self, data: &[u8]) -> Option<Vec<u8>> {
        let mut fields = Fields(data);
        if fields.u8()? == 0 {
            let remains_s = f64::from(fields.u32().unwrap_or(0).min(60_000)) * 1e-3;
            self.order(Order::Relax { remains_s });
        }
        None
    }

    fn position(&mut self, data: &[u8]) -> Option<Vec<u8>> {
        let pos_m = Fields(data).f32s()?;
        self.order(Order::Position(pos_m));
        None
    }

    fn localization(&mut self, data: &[u8]) -> Option<Vec<u8>> {
        let mut fields = Fields(data);
        let order = match fields.u8()? {
            3 => Order::Emergency,
            4 => Order::EmergencyWatchdog,
            8 => {
                let (pos_m, attitude) = (fields.f32s()?, fields.f32s()?);
                Order::Pose { pos_m, yaw_rad: heading_rad(attitude) }
            }
            _ => return None,
        };
        self.order(order);
        None
    }

    /// The request with a status in its fourth byte, as the firmware answers.
    fn high_level(&mut self, data: &[u8]) -> Option<Vec<u8>> {
        let understood = read_request(data, &mut self.group_mask, &mut self.memory)?;
        if let Some(command) = understood.command {
            self.order(Order::HighLevel(command));
        }
        let mut answer = data[..data.len().min(3)].to_vec();
        answer.resize(3, 0);
        answer.push(understood.status);
        Some(answer)
    }

    /// A time in the past is answered at once, behind all answers before it; the rest by the tick that reaches it.
    /// Ticks wait for a client from its first wish for one on: others may wait for theirs while it only looks.
    fn answer_clock(&mut self, data: &[u8]) -> Option<Vec<u8>> {
        let clock = self.clock.as_mut()?;
        let until_ms = Fields(data).u32()?;
        if until_ms <= clock.now_ms {
            return Some(clock.now_ms.to_le_bytes().to_vec());
        }
        (clock.is_driven, clock.until_ms) = (true, Some(until_ms));
        clock.changed.notify_one();
        None
    }

    fn supervisor_info(&self, data: &[u8]) -> Option<Vec<u8>> {
        let info = self.shown.info;
        let bits = |mask: u16| vec![data[0] | 0x80, u8::from(info & mask != 0)];
        match data.first()? {
            0x0c => Some([&[0x8c][..], &info.to_le_bytes()].concat()),
            // one bit each, in their order
            kind @ 1..=0x0b => Some(bits(1 << (kind - 1))),
            _ => None,
        }
    }

    fn supervise(&mut self, data: &[u8]) -> Option<Vec<u8>> {
        let mut fields = Fields(data);
        let command = fields.u8()?;
        let (order, done, now) = match command {
            1 => {
                let arm = fields.bool()?;
                let done = !arm || self.shown.info & (bit::CAN_BE_ARMED | bit::IS_ARMED) != 0;
                (Order::Arm(arm), done, arm && done)
            }
            2 => {
                let done = self.shown.info & bit::IS_LOCKED == 0 && !self.shown.touches;
                (Order::Recover, done, done)
            }
            3 => (Order::Emergency, true, true),
            4 => (Order::EmergencyWatchdog, true, true),
            _ => return None,
        };
        self.order(order);
        Some(vec![command | 0x80, done.into(), now.into()])
    }

    /// The older way to arm and to recover.
    fn platform(&mut self, data: &[u8]) -> Option<Vec<u8>> {
        let mut fields = Fields(data);
        match fields.u8()? {
            1 => {
                let arm = fields.bool()?;
                self.order(Order::Arm(arm));
            }
            2 => self.order(Order::Recover),
            _ => {}
        }
        Some(data.to_vec())
    }

    /// The last one is the kind of vehicle: a simulated one tells the name of its model.
    fn version(&self, data: &[u8]) -> Option<Vec<u8>> {
        let kind = *data.first()?;
        let told = match kind {
            0 => &[PROTOCOL_VERSION],
            1 => env!("CARGO_PKG_VERSION").as_bytes(),
            2 => self.vehicle.as_bytes(),
            _ => return None,
        };
        Some([&[kind][..], &told[..told.len().min(MAX_DATA - 1)]].concat())
    }

    /// Handles packets to the radio chip: off, on and restart. On again, the drone has its
    /// parameters as at the start, and no lock.
    fn power(&mut self, data: &[u8]) {
        match data {
            [NRF_TARGET, 0x01 | 0x02, ..] => self.order(Order::Emergency),
            [NRF_TARGET, 0x03 | 0xf0, ..] => {
                self.begin();
                self.orders.clear();
                self.order(Order::Restart);
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests;
