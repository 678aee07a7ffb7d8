//! The schema's identity: what two programs compare before one lets the other move anything.
//!
//! The identity is a hash of [`TEXT`], which describes the messages as postcard writes them: fields in order,
//! variants by number. A test pins the bytes of a sample of each message beside the identity, so neither can
//! change alone.

/// Version for people; raise it with every change of [`TEXT`].
pub const VERSION: u32 = 6;

/// The part of [`TEXT`] that parameters are written by.
macro_rules! parameters {
    () => {
        "\
settings lamp_warm_up_s:u16 lamp_least_reading:u16 lease_ms:u32 lamp_lease_ms:u32 \
lamp_safe_level:u16 lamp_longest_s:u32 fan_run_on_s:u16 camera_wait_ms:u16 coordinated:bool pulse_us:u8 \
        direction_setup_us:u8 \
inverted:pins
axis_parameters min_steps:i32 max_steps:i32 max_speed:u32(steps/s) acceleration:u32(steps/s2) \
        jerk:u32(steps/s3) \
full_turn_steps:u32 take_up_steps:u32 \
settle_ms:u16 home_direction(0:negative 1:positive) home_position:i32 home_speed:u32 home_slow_speed:u32 \
home_back_off:u32 home_switch_steps:u32 home_order:u8 home_travel:u32 home_debounce_us:u16 \
        index_tolerance:u16 driver:option driver_parameters \
inverted:pins alarm(0:none 1:level 2:edge) alarm_debounce_us:u16 most_turns:u8
driver_parameters run_ma:u16 hold_ma:u16 sense_mohm:u16 microsteps:u16 stall_threshold:u8 \
        stall_above_speed:u32(steps/s)
pins u16 bits 0:step 1:direction 2:enable 3:home 4:alarm 5:lamp 6:shutter 7:fan 8:over_temperature \
        9:camera_ready
keep_out first:axis first_steps:[i32;2] second:axis second_steps:[i32;2]
"
    };
}

/// The schema, described.
pub const TEXT: &str = concat!(
    "\
axes pan tilt roll light
request session:u32 id:u32 seen:u32 command
command 0:configure(settings) 1:home 2:move_to([i32;4]) 3:stop 4:lamp(on:bool level:u16) \
5:expose(duration_us:u32 warm_lamp:bool) 6:status 7:clear_faults 8:retarget([i32;4]) \
9:home_repeatedly(approaches:u8) 10:check_index 11:save_parameters 12:prepare_axis(axis axis_parameters) \
13:read_axis(axis) 14:read_settings 15:watch(telemetry_ms:u16 log:bool) \
16:home_axes([bool;4] approaches:u8) 17:read_health 18:prepare_keep_outs([option keep_out;4]) \
        19:read_keep_outs
",
    parameters!(),
    "\
response session:u32 id:u32 outcome(0:done(answer) 1:refused(refusal) 2:running)
answer 0:nothing 1:at([i32;4]) 2:exposed(start_us:u64 open_us:u32 reference_q8:u32 readings:u32 \
        flicker_ppm:u32) 3:status(status) \
4:homed(positions:[i32;4] spread_steps:[u32;4] approaches:u8) 5:checked([i32;4]) 6:axis(axis_parameters) \
        7:settings(settings) \
8:health(health) 9:keep_outs([option keep_out;4])
refusal 0:no_session 1:stale 2:not_configured 3:bad_parameter(axis:option field) 4:busy \
        5:position_unknown(axis) \
6:out_of_limits(axis) 7:lamp_not_warm(remaining_s:option u16) 8:faulted(faults) 9:emergency_stop_pressed \
        10:stopped \
11:camera_not_ready 12:shutter_late(late_us:u32) 13:out_of_window 14:no_storage \
15:driver(axis trouble(0:no_wire 1:current 2:microsteps 3:silent 4:garbled 5:write_lost)) \
 16:skipped(after:u32) 17:not_at_rest 18:keep_out(first:axis second:axis)
field 0:limits 1:max_speed 2:acceleration 3:take_up 4:home_position 5:home_speed 6:home_travel 7:duration \
        8:jerk \
9:full_turn 10:approaches 11:telemetry_period 12:pulse 13:step_rate 14:axes 15:lamp_time 16:alarm 17:wiring \
        18:keep_out
status positions:[i32;4] known:[bool;4] moving:[bool;4] at_switch:[bool;4] configured:bool busy:bool \
        waiting:u8 \
lamp(on:bool level:u16 warm:bool remaining_s:u16) faults emergency_stop:bool uptime_us:u64 alarms:[bool;4]
faults u16 bits 0:emergency_stop 1:limit_hit 2:homing_failed 3:hardware 4:steps_lost 5:stall \
6:over_temperature 7:lamp_failure 8:lease_expired 9:steps_late 10:switch_stuck 11:lamp_timeout \
        12:driver_lost 13:driver_alarm
event 0:fault(fault axis:option at_us:u64) 1:crashed(cause place:u32) \
2:telemetry(at_us:u64 positions:[i32;4] photodiode:option u16 frames:u32 bad_frames:u32 dropped:u32 health) \
3:log(at_us:u64 happening) 4:migrated(from:u32)
health worst_late_us:u32 longest_poll_us:u32 stack:option(used:u32 of:u32) overruns:u32 supply_mv:option u16
happening 0:began(id:u32) 1:ended(id:u32 done:bool) 2:lamp(on:bool level:u16) 3:faults_cleared \
        4:bad_frames(count:u32) \
5:dropped(count:u32)
cause 0:panic 1:stack_overflow 2:hard_fault 3:watchdog
"
);

/// The schema's identity: FNV-1a, 64 bits, of [`VERSION`] and [`TEXT`].
pub const IDENTITY: u64 = identity(VERSION, TEXT);

/// The identity of what parameters are written as: saved ones outlive a change of the rest of the schema.
pub const PARAMETERS: u64 = identity(0, parameters!());

/// FNV-1a, 64 bits, of a version and a text.
pub const fn identity(version: u32, text: &str) -> u64 {
    fnv1a(fnv1a(0xcbf2_9ce4_8422_2325, &version.to_le_bytes()), text.as_bytes())
}

const fn fnv1a(mut hash: u64, bytes: &[u8]) -> u64 {
    let mut i = 0;
    while i < bytes.len() {
        hash = (hash ^ bytes[i] as u64).wrapping_mul(0x0000_0100_0000_01b3);
        i += 1;
    }
    hash
}
