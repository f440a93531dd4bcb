//! Where the camera is: it fits the first whole turn of a sensor.

use std::fs::File;
use std::net::{SocketAddr, SocketAddrV4};
use std::path::Path;

use serde_json::Value;
use sweepd::input::write::Addressed;
use sweepd::input::{Capture, PcapWriter};
use sweepd::pipeline::Config;
use sweepd::sweep::SweepMut;
use sweepd::sweep::layout::flags;
use sweepd_testkit::TempDomain;

use crate::browser::Tab;
use crate::captures::{fixture, sweeps};
use crate::live::{self, Publisher};
use crate::page::View;

const FITTED: &str = "window.sweepd.page.cloud.camera.aspect !== null";

fn camera(tab: &mut Tab) -> Value {
    tab.value(
        "(({ distance, target, yaw, pitch }) => [distance, target, yaw, pitch])(window.sweepd.page.cloud.camera)",
    )
}

/// Chooses a sensor by its place in the list.
fn choose(tab: &mut Tab, place: usize) {
    tab.wait_for("document.getElementById('sensor').options.length === 2");
    tab.value(&format!(
        "(() => {{ const choice = document.getElementById('sensor'); choice.selectedIndex = {place}; \
         choice.dispatchEvent(new Event('change')); }})()"
    ));
}

/// Writes a capture of two sensors, one after the other.
fn write_two_sensors(path: &Path) {
    let mut writer = PcapWriter::new(File::create(path).unwrap()).unwrap();
    for (name, address) in [
        ("street_vlp16.pcap.gz", [192, 168, 1, 201]),
        ("street_hdl32e.pcap.gz", [192, 168, 1, 202]),
    ] {
        let mut capture = Capture::open(Path::new(&fixture(name))).unwrap();
        while let Some(placed) = capture.next_placed().unwrap() {
            let datagram = placed.datagram;
            let SocketAddr::V4(source) = datagram.source else {
                panic!("{name}");
            };
            writer
                .write(&Addressed {
                    arrival_ns: datagram.arrival_ns,
                    source: SocketAddrV4::new(address.into(), source.port()),
                    destination: SocketAddrV4::new([255; 4].into(), datagram.destination_port),
                    payload: datagram.payload,
                })
                .unwrap();
        }
    }
    writer.finish().unwrap();
}

/// The sweep of the sensor that is chosen follows without a gap. The expected camera is that of a
/// page that begins with that sensor.
#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn it_fits_another_sensor_of_a_capture() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("two.pcap");
    write_two_sensors(&path);
    let view = View::start(&[path.to_str().unwrap()]);
    let mut tab = Tab::open(&format!("http://{}/#sweep=1", view.host));
    tab.wait_for(FITTED);
    let first = camera(&mut tab);
    tab.press("+");
    assert_ne!(camera(&mut tab), first);
    choose(&mut tab, 1);
    // An HDL-32E.
    let is_second = format!("{FITTED} && window.sweepd.page.shown.header.rows === 32");
    tab.wait_for(&is_second);
    let second = camera(&mut tab);
    let mut fresh = Tab::open(&format!("http://{}/", view.host));
    fresh.wait_for(&is_second);
    assert_eq!(second, camera(&mut fresh));
    assert_ne!(second, first);
    fresh.close();
    tab.close();
}

/// Part of a turn decides nothing; nor does what another sensor had, or a later turn.
#[test]
#[cfg_attr(without_chromium, ignore = "no chromium")]
fn it_fits_the_first_whole_turn_of_a_sensor() {
    let own = TempDomain::new("sweepd-view-").unwrap();
    let street = sweeps(&fixture("street_vlp16.pcap.gz"), &Config::default());
    let other = sweeps(&fixture("street_hdl32e.pcap.gz"), &Config::default());
    let mut part = sweeps(&fixture("street_vlp16.pcap.gz"), &Config::default()).remove(0);
    let header = SweepMut::open(part.as_mut()).unwrap().header;
    header.flags |= flags::PARTIAL;
    let [mut front, mut roof] = ["front", "roof"].map(|name| Publisher::new(&own.domain(), name));
    let view = live::view(&own, &["roof"]);
    let mut page = view.page();
    page.words("no sweep of roof for ");
    roof.publish(&part);
    page.sweep();
    let mut tab = Tab::open(&format!("http://{}/", view.host));
    assert_eq!(tab.value(FITTED), false);
    roof.publish(&street[1]);
    tab.wait_for(FITTED);
    let first = camera(&mut tab);
    roof.publish(&other[1]);
    tab.wait_for("window.sweepd.sequence === 2");
    assert_eq!(camera(&mut tab), first);

    choose(&mut tab, 0);
    tab.wait_for("!document.getElementById('none').hidden");
    let second_return = "document.getElementById('second').hidden";
    assert_eq!(tab.value(second_return), true, "there is no sweep");
    tab.wait_for(
        "document.querySelector('#state').textContent.startsWith('no sweep of front for ')",
    );
    front.publish(&other[1]);
    tab.wait_for(FITTED);
    assert_ne!(camera(&mut tab), first);
    tab.close();
}
