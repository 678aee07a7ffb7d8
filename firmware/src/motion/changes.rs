//! When a plan may be changed: what that takes must not add up over all axes, nor delay steps that have to be
//! handed over.

/// Whether plans may be changed in this poll: a run begun, cut short or turned into a braking one. That takes
/// long on a small processor, so there is one change a poll, and none while an axis has to be handed steps.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Changes {
    allowed: bool,
    /// How often one was refused since the last was made.
    refused: u8,
}

impl Changes {
    /// After so many refusals a change is made whatever waits: where planning never catches up, steps come
    /// late anyway.
    const PATIENCE: u8 = 64;

    /// At a poll's beginning: whether an axis `needs` steps.
    pub(crate) fn begin(&mut self, needs: bool) {
        self.allowed = !needs || self.refused >= Self::PATIENCE;
    }

    /// Whether a change may be made, which it then has to be.
    pub(crate) fn take(&mut self) -> bool {
        self.refused = if self.allowed { 0 } else { self.refused.saturating_add(1) };
        core::mem::take(&mut self.allowed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_plan_is_changed_a_poll_and_none_while_an_axis_needs_steps_but_not_for_ever() {
        let mut changes = Changes::default();
        changes.begin(false);
        assert_eq!([changes.take(), changes.take(), changes.take()], [true, false, false]);
        let mut polls = 0;
        while {
            changes.begin(true);
            !changes.take()
        } {
            polls += 1;
            assert!(polls < 100, "a brake that is never made");
        }
        assert!(polls > 50);
        changes.begin(true);
        assert!(!changes.take(), "patience begins anew");
    }
}
