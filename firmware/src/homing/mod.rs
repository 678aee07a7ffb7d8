//! Homing of one axis, and checking without forgetting: seek the switch, back off, seek again slowly, and
//! take the switch's edge for the position that the configuration gives it; or compare the two.
//!
//! The edge is always measured upward: with the switch at the lower end, as it opens on the way out; with the
//! switch at the upper end, as it closes on the way in. So the play is on the same side as after every move.
//! An edge counts once the switch has kept its new state for the debounce time; its position is that of the
//! first step that saw it.
//!
//! Only the first search goes the whole travel. Away from the switch an axis goes no farther than it ran on
//! past the edge, than the switch is wide, and the back-off: a broken wire reads as closed, and must not
//! drive the axis into what is at its other end.

use lobelia_protocol::{AxisParameters, HomeDirection};

use crate::board::Board;
use crate::motion::axis::AxisDrive;
use crate::motion::pulses::{PulsesCell, Sight};
use crate::pin::PinFailure;

/// What an axis is doing to find its home.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Fast, toward the switch, until it closes.
    Seek,
    /// Away from the switch, until it opens, then farther.
    BackOff,
    /// Slowly toward the switch, until it closes.
    SlowSeek,
    /// Slowly upward, until it opens: only with the switch at the lower end.
    Leave,
    /// At rest, edge measured.
    Done,
}

/// What a search is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Purpose {
    /// To find the position, after so many slow approaches.
    Home {
        /// At least 1.
        approaches: u8,
    },
    /// To see whether the position counted is still right.
    Check,
}

/// How far homing has got, or that it can't.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Progress {
    /// Under way.
    Seeking,
    /// The edge was measured.
    Measured,
    /// The switch didn't close within the travel.
    Failed,
    /// The switch stayed closed over its whole width.
    Stuck,
}

/// One axis's search for its home.
#[derive(Debug)]
pub(crate) struct Homing {
    purpose: Purpose,
    phase: Phase,
    /// Where it closed or opened in this phase, as it should.
    edge: Option<i32>,
    /// Where it began, if it seemed to be at its switch there, until that has shown.
    seemed_at_switch: Option<i32>,
    approaches_left: u8,
    /// Lowest and highest edge of the approaches so far.
    edges: Option<(i32, i32)>,
    /// The edge's position as counted before, less what it should be.
    lost: i32,
}

impl Homing {
    /// Begins.
    pub(crate) fn start<B: Board>(
        now_us: u64,
        purpose: Purpose,
        axis: &mut AxisDrive<B>,
        pulses: &mut B::Pulses,
        p: &AxisParameters,
    ) -> Result<Self, PinFailure> {
        let approaches_left = match purpose {
            Purpose::Home { approaches } => {
                axis.forget(pulses, p);
                approaches
            }
            Purpose::Check => 1,
        };
        let phase =
            if pulses.with(|pulses| pulses.at_switch(axis.axis()))? { Phase::BackOff } else { Phase::Seek };
        let position = pulses.with(|pulses| pulses.trains.position(axis.axis()));
        let seemed_at_switch = (phase == Phase::BackOff).then_some(position);
        let mut homing =
            Self { purpose, phase, edge: None, seemed_at_switch, approaches_left, edges: None, lost: 0 };
        homing.enter(phase, now_us, axis, pulses, p)?;
        Ok(homing)
    }

    /// Whether at rest it goes on with another run.
    pub(crate) fn goes_on(&self) -> bool {
        self.phase != Phase::Done && self.edge.is_some()
    }

    /// Steps between the farthest edges of all approaches.
    pub(crate) fn spread(&self) -> u32 {
        self.edges.map_or(0, |(lowest, highest)| highest.abs_diff(lowest))
    }

    /// Steps that the position counted was too high by, when checked.
    pub(crate) fn lost(&self) -> i32 {
        self.lost
    }

    /// On the way: whether the switch has kept the state awaited for long enough, as far as it was looked at.
    pub(crate) fn watch<B: Board>(
        &mut self,
        now_us: u64,
        axis: &mut AxisDrive<B>,
        pulses: &mut B::Pulses,
        p: &AxisParameters,
    ) {
        if self.edge.is_none()
            && let Some(sight) = self.awaited_sight(axis, pulses)
            && sight.lasted_us() >= p.home_debounce_us.into()
        {
            self.edge = Some(sight.position);
            if axis.moving() {
                axis.shorten(pulses, now_us, if self.phase == Phase::BackOff { p.home_back_off } else { 0 });
            }
        }
    }

    /// The switch, if it was last seen as this phase awaits it.
    fn awaited_sight<B: Board>(&self, axis: &AxisDrive<B>, pulses: &mut B::Pulses) -> Option<Sight> {
        let awaited = matches!(self.phase, Phase::Seek | Phase::SlowSeek);
        pulses.with(|pulses| pulses.sight(axis.axis())).filter(|sight| sight.closed == awaited)
    }

    /// At rest: goes on to the next phase.
    pub(crate) fn rested<B: Board>(
        &mut self,
        now_us: u64,
        axis: &mut AxisDrive<B>,
        pulses: &mut B::Pulses,
        p: &AxisParameters,
    ) -> Result<Progress, PinFailure> {
        if self.phase == Phase::Done {
            return Ok(Progress::Measured);
        }
        let Some(edge) = self.edge else {
            // What was seen last may yet turn out to last.
            return Ok(match (self.awaited_sight(axis, pulses), self.phase) {
                (Some(_), _) => Progress::Seeking,
                (None, Phase::BackOff | Phase::Leave) => Progress::Stuck,
                (None, _) => Progress::Failed,
            });
        };
        // Open from the first look on: a single look at the start was wrong, and the switch may be far.
        let was_open = self.seemed_at_switch.take().is_some_and(|start| edge.abs_diff(start) <= 2);
        let next = match (self.phase, p.home_direction) {
            (Phase::BackOff, _) if was_open => Phase::Seek,
            (Phase::Seek, _) => Phase::BackOff,
            (Phase::BackOff, _) => Phase::SlowSeek,
            (Phase::SlowSeek, HomeDirection::Negative) => Phase::Leave,
            (Phase::SlowSeek, HomeDirection::Positive) | (Phase::Leave | Phase::Done, _) => {
                let (lowest, highest) = self.edges.unwrap_or((edge, edge));
                self.edges = Some((lowest.min(edge), highest.max(edge)));
                self.approaches_left = self.approaches_left.saturating_sub(1);
                if self.approaches_left == 0 {
                    self.conclude(edge, axis, pulses, p);
                    return Ok(Progress::Measured);
                }
                Phase::BackOff
            }
        };
        self.enter(next, now_us, axis, pulses, p)?;
        Ok(Progress::Seeking)
    }

    fn conclude<B: Board>(
        &mut self,
        edge: i32,
        axis: &mut AxisDrive<B>,
        pulses: &mut B::Pulses,
        p: &AxisParameters,
    ) {
        self.phase = Phase::Done;
        let position = pulses.with(|pulses| pulses.trains.position(axis.axis()));
        match self.purpose {
            Purpose::Home { .. } => axis.homed(pulses, p.home_position + (position - edge)),
            Purpose::Check => {
                self.lost = whole_turns_off(edge.saturating_sub(p.home_position), p.full_turn_steps);
                axis.homed(pulses, position);
            }
        }
    }

    fn enter<B: Board>(
        &mut self,
        phase: Phase,
        now_us: u64,
        axis: &mut AxisDrive<B>,
        pulses: &mut B::Pulses,
        p: &AxisParameters,
    ) -> Result<(), PinFailure> {
        let position = pulses.with(|pulses| pulses.trains.position(axis.axis()));
        let from_edge = self.edge.map_or(0, |edge| position.abs_diff(edge));
        let reach = match phase {
            Phase::Seek | Phase::Done => p.home_travel,
            // As far back as it ran on past the edge that it saw last.
            Phase::BackOff | Phase::Leave => {
                from_edge.saturating_add(p.home_switch_steps).saturating_add(p.home_back_off)
            }
            Phase::SlowSeek => from_edge.saturating_add(p.home_switch_steps),
        };
        self.phase = phase;
        self.edge = None;
        let toward_switch = matches!(phase, Phase::Seek | Phase::SlowSeek);
        let fast = matches!(phase, Phase::Seek | Phase::BackOff);
        let speed = if fast { p.home_speed } else { p.home_slow_speed };
        let upward = toward_switch == (p.home_direction == HomeDirection::Positive);
        let target = if upward {
            position.saturating_add_unsigned(reach)
        } else {
            position.saturating_sub_unsigned(reach)
        };
        axis.run(pulses, now_us, target, speed, p)
    }
}

/// A difference of positions on an axis that may have gone round.
fn whole_turns_off(difference: i32, full_turn: u32) -> i32 {
    let turn = full_turn as i32;
    if turn == 0 {
        return difference;
    }
    let positive = difference.rem_euclid(turn);
    if positive > turn / 2 { positive - turn } else { positive }
}
