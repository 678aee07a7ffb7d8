//! Checks of hello, session and parameters.

use lobelia_protocol::{
    AXES, Answer, Axis, AxisParameters, Command, Field, Hello, KeepOut, Outcome, Refusal, Request,
    SafeCommand, Verdict, schema,
};

use super::Script;
use super::bench::{Bench, Result, Trouble, ensure, same};

pub(super) const CHECKS: &[(&str, Script)] = &[
    ("a hello opens a session and is answered with schema and session", hello),
    ("a hello of another schema is refused with the controller's own version", other_schema),
    ("a host of another version may ask for the state, stop and darken, without a session", safe),
    ("a request of a session that isn't open is refused", closed_session),
    ("a status tells that parameters are set", configured),
    ("parameters are read back as they were set", read_back),
    ("parameters out of range are refused and change nothing", bad_parameters),
    ("keep-outs that make no sense are refused and change nothing", bad_keep_outs),
    ("health is told, with no more stack used than there is", health),
    ("other parameters make positions unknown", other_parameters),
    ("a move is refused before homing", no_move_before_homing),
    ("an index check is refused before homing", no_check_before_homing),
];

fn hello(bench: &mut Bench) -> Result<()> {
    let reply = bench.open()?;
    same("the reply", &Hello::new(bench.session).reply(), &reply)
}

fn other_schema(bench: &mut Bench) -> Result<()> {
    let other = Hello { schema: !schema::IDENTITY, version: schema::VERSION + 1000, session: bench.session };
    let reply = bench.greet(other)?;
    same("the verdict", &Verdict::DifferentSchema, &reply.verdict)?;
    same("the schema", &schema::IDENTITY, &reply.hello.schema)?;
    same("the version", &schema::VERSION, &reply.hello.version)
}

fn safe(bench: &mut Bench) -> Result<()> {
    other_schema(bench)?;
    for command in [SafeCommand::Ask, SafeCommand::Stop, SafeCommand::Darken, SafeCommand::Unknown(200)] {
        let state = bench.safe(command)?;
        ensure(!state.moving && !state.shutter, || format!("to {command:?} it tells {state:?}"))?;
        ensure(command != SafeCommand::Darken || !state.lamp, || "the lamp burns on".to_owned())?;
    }
    bench.open().map(|_| ())
}

fn closed_session(bench: &mut Bench) -> Result<()> {
    bench.open()?;
    let request = Request { session: !bench.session, id: 1, seen: 0, command: Command::Home };
    bench.send(&request)?;
    let outcome = bench.outcome(&request)?;
    same("its outcome", &Outcome::Refused(Refusal::NoSession), &outcome)
}

fn configured(bench: &mut Bench) -> Result<()> {
    let status = bench.settle()?;
    ensure(status.configured, || "it says that none are".to_owned())
}

fn read_back(bench: &mut Bench) -> Result<()> {
    bench.settle()?;
    for axis in Axis::ALL {
        let parameters = bench.configuration.axes[axis.index()];
        same(axis.name(), &Answer::Axis(parameters), &bench.done(Command::ReadAxis(axis))?)?;
    }
    same("settings", &Answer::Settings(bench.configuration.settings), &bench.done(Command::ReadSettings)?)
}

fn bad_parameters(bench: &mut Bench) -> Result<()> {
    let before = bench.settle()?.known;
    let bend = |axis: Axis, change: fn(&mut AxisParameters)| {
        let mut parameters = bench.configuration.axes[axis.index()];
        change(&mut parameters);
        Command::PrepareAxis { axis, parameters }
    };
    let bent = [
        (bend(Axis::Pan, |axis| axis.max_speed = 0), Axis::Pan, Field::MaxSpeed),
        (bend(Axis::Tilt, |axis| axis.min_steps = axis.max_steps + 1), Axis::Tilt, Field::Limits),
        (bend(Axis::Roll, |axis| axis.acceleration = 0), Axis::Roll, Field::Acceleration),
    ];
    for (command, axis, field) in bent {
        bench.refused(command, Refusal::BadParameter { axis: Some(axis), field })?;
    }
    bench.done(Command::Configure(bench.configuration.settings))?;
    same("known axes", &before, &bench.status()?.known)
}

fn bad_keep_outs(bench: &mut Bench) -> Result<()> {
    let before = bench.settle()?.known;
    let twice = KeepOut { first: Axis::Pan, first_steps: [0, 1], second: Axis::Pan, second_steps: [0, 1] };
    bench.done(Command::PrepareKeepOuts([Some(twice), None, None, None]))?;
    let why = Refusal::BadParameter { axis: Some(Axis::Pan), field: Field::KeepOut };
    bench.refused(Command::Configure(bench.configuration.settings), why)?;
    bench.configure(&bench.configuration.clone())?;
    let expected = Answer::KeepOuts(bench.configuration.keep_outs);
    same("keep-outs", &expected, &bench.done(Command::ReadKeepOuts)?)?;
    same("known axes", &before, &bench.status()?.known)
}

fn health(bench: &mut Bench) -> Result<()> {
    bench.settle()?;
    let Answer::Health(health) = bench.done(Command::ReadHealth)? else {
        return Err(Trouble::Wrong("it was answered by something else".to_owned()));
    };
    let fits = health.stack.is_none_or(|[used, of]| used <= of);
    ensure(fits, || format!("it tells the stack {:?}", health.stack))
}

fn other_parameters(bench: &mut Bench) -> Result<()> {
    bench.settle()?;
    let mut other = bench.configuration;
    other.axes[3].settle_ms ^= 1;
    bench.configure(&other)?;
    bench.configure(&bench.configuration.clone())?;
    same("known axes", &[false; AXES], &bench.status()?.known)
}

fn no_move_before_homing(bench: &mut Bench) -> Result<()> {
    other_parameters(bench)?;
    let before = bench.status()?.positions;
    bench.refused(Command::MoveTo(bench.part_way(0.5)), Refusal::PositionUnknown(Axis::Pan))?;
    same("positions", &before, &bench.status()?.positions)
}

fn no_check_before_homing(bench: &mut Bench) -> Result<()> {
    other_parameters(bench)?;
    bench.refused(Command::CheckIndex, Refusal::PositionUnknown(Axis::Pan))
}
