//! Homing of one axis: seek the switch, back off, seek again slowly, and take the switch's edge for the position that
//! the configuration gives it.
//!
//! The edge is always measured upward: with the switch at the lower end, as it opens on the way out; with the switch at
//! the upper end, as it closes on the way in. So the play is on the same side as after every move.

use lobelia_protocol::{AxisParameters, HomeDirection};

use crate::board::{Board, PinFailure};
use crate::motion::axis::AxisDrive;

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
    /// At rest, position known.
    Done,
}

/// How far homing has got, or that it can't.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Progress {
    /// Under way.
    Seeking,
    /// Position known.
    Homed,
    /// The switch didn't close, or open, within the travel.
    Failed,
}

/// One axis's search for its home.
#[derive(Debug)]
pub(crate) struct Homing {
    phase: Phase,
    /// Where the switch closed or opened in this phase, as it should.
    edge: Option<i32>,
}

impl Homing {
    /// Begins.
    pub(crate) fn start<B: Board>(
        now_us: u64,
        axis: &mut AxisDrive<B>,
        p: &AxisParameters,
    ) -> Result<Self, PinFailure> {
        axis.forget();
        let phase = if axis.at_switch()? { Phase::BackOff } else { Phase::Seek };
        let mut homing = Self { phase, edge: None };
        homing.enter(phase, now_us, axis, p)?;
        Ok(homing)
    }

    /// After each step: looks at the switch.
    pub(crate) fn stepped<B: Board>(
        &mut self,
        now_us: u64,
        axis: &mut AxisDrive<B>,
        p: &AxisParameters,
    ) -> Result<(), PinFailure> {
        if self.edge.is_some() {
            return Ok(());
        }
        let awaited = matches!(self.phase, Phase::Seek | Phase::SlowSeek);
        if axis.at_switch()? == awaited {
            self.edge = Some(axis.position());
            axis.shorten(now_us, if self.phase == Phase::BackOff { p.home_back_off } else { 0 });
        }
        Ok(())
    }

    /// At rest: goes on to the next phase.
    pub(crate) fn rested<B: Board>(
        &mut self,
        now_us: u64,
        axis: &mut AxisDrive<B>,
        p: &AxisParameters,
    ) -> Result<Progress, PinFailure> {
        if self.phase == Phase::Done {
            return Ok(Progress::Homed);
        }
        let Some(edge) = self.edge else {
            return Ok(Progress::Failed);
        };
        let next = match (self.phase, p.home_direction) {
            (Phase::Seek, _) => Phase::BackOff,
            (Phase::BackOff, _) => Phase::SlowSeek,
            (Phase::SlowSeek, HomeDirection::Negative) => Phase::Leave,
            (Phase::SlowSeek, HomeDirection::Positive) | (Phase::Leave | Phase::Done, _) => {
                axis.homed(p.home_position + (axis.position() - edge));
                self.phase = Phase::Done;
                return Ok(Progress::Homed);
            }
        };
        self.enter(next, now_us, axis, p)?;
        Ok(Progress::Seeking)
    }

    fn enter<B: Board>(
        &mut self,
        phase: Phase,
        now_us: u64,
        axis: &mut AxisDrive<B>,
        p: &AxisParameters,
    ) -> Result<(), PinFailure> {
        self.phase = phase;
        self.edge = None;
        let toward_switch = matches!(phase, Phase::Seek | Phase::SlowSeek);
        let fast = matches!(phase, Phase::Seek | Phase::BackOff);
        let speed = if fast { p.home_speed } else { p.home_slow_speed };
        let upward = toward_switch == (p.home_direction == HomeDirection::Positive);
        let position = axis.position();
        let target = if upward {
            position.saturating_add_unsigned(p.home_travel)
        } else {
            position.saturating_sub_unsigned(p.home_travel)
        };
        axis.run(now_us, target, speed, p)
    }
}
