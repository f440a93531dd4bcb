//! What other programs say: nodes and clients of ROS 2, the other end of the control socket, a daemon
//! that is asked for its health.

use sweepd::daemon::record::protocol::{Reply, Request, SettingsRequest};
use sweepd::doctor::observe::{Host, ObservedPort, PortResult};
use sweepd::doctor::plan::ExaminedPort;
use sweepd::doctor::{Observations, Plan, diagnose};
use sweepd::messages::odometry::Located;
use sweepd::messages::rcl::{PARAMETER_SERVICES, Request as ParameterRequest};

/// A CDR text has its length and a NUL.
const LEAST_TEXT: usize = 5;

/// A message in CDR, read as each type that is read.
pub fn cdr(input: &[u8]) {
    for service in 0..PARAMETER_SERVICES.len() {
        let texts = match ParameterRequest::read(service, input) {
            Ok(ParameterRequest::Set(all) | ParameterRequest::SetAll(all)) => all.len(),
            Ok(
                ParameterRequest::List(names, _)
                | ParameterRequest::Get(names)
                | ParameterRequest::Types(names)
                | ParameterRequest::Describe(names),
            ) => names.len(),
            Err(_) => 0,
        };
        assert!(LEAST_TEXT * texts <= input.len(), "{texts} texts");
    }
    let whole = Located::of_odometry(input).ok();
    let child = whole.map_or("base_link", |located| located.child);
    if let Ok(Some(located)) = Located::of_transforms(input, child) {
        assert_eq!(located.child, child);
    }
}

/// A line on the control socket, as either end reads it.
pub fn control(input: &[u8]) {
    match Request::parse(input) {
        Ok(request) => {
            let line = serde_json::to_vec(&request).expect("JSON");
            assert_eq!(Request::parse(&line), Ok(request));
        }
        Err(why) => assert!(!why.is_empty()),
    }
    if let Ok(request) = serde_json::from_slice::<SettingsRequest>(input) {
        let line = serde_json::to_vec(&request).expect("JSON");
        assert_eq!(serde_json::from_slice(&line).ok(), Some(request));
    }
    if let Ok(reply) = serde_json::from_slice::<Reply>(input) {
        // Numbers in digits may differ in the last of them.
        let line = serde_json::to_vec(&reply).expect("JSON");
        serde_json::from_slice::<Reply>(&line).expect("what was written is read");
    }
}

/// What a daemon, of any version, says at `/health`: the doctor reads it.
pub fn health(input: &[u8]) {
    let Ok(said) = serde_json::from_slice(input) else {
        return;
    };
    let port = ExaminedPort {
        bind: [0; 4].into(),
        port: 2368,
        multicast: None,
        interface: None,
    };
    let seen = Observations {
        plan: Plan {
            ports: vec![port.clone()],
            sensors: Vec::new(),
            ask: Vec::new(),
            root: None,
            health: None,
        },
        seconds: 5.0,
        ports: vec![ObservedPort {
            plan: port,
            result: PortResult::Taken("port 2368 is taken".to_owned()),
        }],
        sensors: Vec::new(),
        positions: Vec::new(),
        host: Host {
            interfaces: Vec::new(),
            drops: None,
            rmem_max: None,
            shared: None,
            root_trouble: None,
        },
        web: Vec::new(),
        daemon: Some(Ok(said)),
    };
    for finding in diagnose(&seen) {
        let is_plain = |text: &str| !text.chars().any(|one| one.is_control() && one != '\n');
        assert!(
            is_plain(&finding.what) && is_plain(&finding.cure),
            "{finding:?}"
        );
    }
}
