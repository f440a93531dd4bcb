//! What this host lacks.

use super::{Findings, sensors};
use crate::doctor::Topic;
use crate::doctor::observe::{Observations, PortResult, RootTrouble};
use crate::doctor::plan::ExpectedSensor;
use crate::judge::Remark;
use crate::publish::pool_sweeps;
use sweepd_core::sensor::{Model, ModelExt};
use sweepd_core::sweep::layout::Shape;
use sweepd_core::wire::data::ReturnMode;

pub(super) fn find(seen: &Observations, findings: &mut Findings) {
    buffers(seen, findings);
    // A running daemon has its memory already.
    if seen.daemon.is_none() {
        shared_memory(seen, findings);
    }
    match &seen.host.root_trouble {
        Some(RootTrouble::Unusable(why)) => {
            findings.warning(
                Topic::SharedMemory,
                why,
                "run this as the user that the daemon runs as, to see what it sees",
            );
        }
        Some(RootTrouble::NotWritable { folder }) => {
            let what = format!(
                "this user may not make files in {}, where shared memory is kept track of",
                folder.display()
            );
            let cure = "give the folder to the daemon's user, or name another with `root` in the configuration";
            findings.error(Topic::SharedMemory, what, cure);
        }
        None => {}
    }
}

fn buffers(seen: &Observations, findings: &mut Findings) {
    for port in &seen.ports {
        let PortResult::Open {
            received,
            dropped,
            buffer,
            ..
        } = port.result
        else {
            continue;
        };
        let number = port.plan.port;
        let sensors = sensors_of(port.plan.port, seen);
        if buffer.is_too_small_for(&sensors) {
            let now = seen.host.rmem_max.map_or(String::new(), |bytes| {
                format!(" (net.core.rmem_max is {bytes})")
            });
            let what = format!(
                "port {number}: the kernel gave a receive buffer for {} packets, {}{now}",
                buffer.packets(),
                buffer.holds(&sensors)
            );
            let cure = format!(
                "`sysctl -w net.core.rmem_max={0}`, for good with the line `net.core.rmem_max = {0}` in /etc/sysctl.d/sweepd.conf",
                buffer.rmem_max()
            );
            findings.warning(Topic::Buffer, what, cure);
        }
        if dropped > 0 && !sensors::tell_drops(number, seen) {
            let remark = Remark::Dropped {
                dropped,
                of: received + dropped,
                port: Some(number),
                is_fault: false,
            };
            findings.0.extend(remark.finding());
        }
    }
}

/// The models of the sensors that send data to a port, as far as they are known: those that came, else
/// those that are configured, else any.
fn sensors_of(port: u16, seen: &Observations) -> Vec<Option<Model>> {
    let came = seen.sensors.iter().filter(|one| one.port == port);
    let mut models: Vec<Option<Model>> = came.map(|one| one.model).collect();
    if models.is_empty() {
        let expected = seen.plan.sensors.iter().filter(|one| one.port == port);
        models = expected.map(|one| one.model).collect();
    }
    if models.is_empty() {
        models.push(None);
    }
    models
}

fn shared_memory(seen: &Observations, findings: &mut Findings) {
    let Some((all, free)) = seen.host.shared else {
        return;
    };
    let needed: u64 = (seen.plan.sensors.iter())
        .map(|one| pool_sweeps(one.max_consumers) as u64 * sweep_bytes(one, seen))
        .sum();
    if needed > free {
        let what = format!(
            "/dev/shm has {} MiB free of {} MiB, the configured sensors need {} MiB",
            mib(free),
            mib(all),
            mib(needed)
        );
        let cure = format!(
            "`mount -o remount,size={}M /dev/shm`, for good in /etc/fstab; in a container --shm-size; or fewer `max_consumers`",
            (all - free + needed).div_ceil(1 << 20) + 16
        );
        findings.error(Topic::SharedMemory, what, cure);
    }
}

/// Bytes of a sweep of a sensor; of the largest possible model, if that is not known.
pub fn sweep_bytes(expected: &ExpectedSensor, seen: &Observations) -> u64 {
    let sensor = seen.sensor_of(expected);
    let found_model = sensor.and_then(|sensor| sensor.model);
    let found_mode = sensor.and_then(|sensor| sensor.return_mode);
    let model = expected.model.or(found_model).unwrap_or(Model::Hdl64eS3);
    let dual = expected
        .dual
        .or(found_mode.map(|mode| mode == ReturnMode::Dual))
        .unwrap_or(true);
    Shape::of(
        model.spec().channels,
        dual,
        expected.segment.min_points as usize,
    )
    .total_bytes() as u64
}

fn mib(bytes: u64) -> u64 {
    bytes >> 20
}
