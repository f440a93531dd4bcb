//! sweepd owns a spinning Velodyne: packets in, range images out, cut into ground and numbered
//! objects.
//!
//! ```text
//! socket | capture -> Datagram -> Packet -> Column -> Sweep -> Labels + Segments -> shared memory | files
//!      input                      wire      assemble  sweep      segment             publish         export
//! ```
//!
//! Everything from [`wire::Datagram`] to the segments is pure: bytes and time come in as arguments.
//! [`pipeline`] takes a sensor's packets and gives its sweeps; a program pushes its datagrams through
//! it:
//!
//! ```
//! use sweepd::input::Capture;
//! use sweepd::pipeline::{Config, Event, Pipeline};
//! use sweepd::buffers::{HeapBuffers, Memory};
//! use sweepd::sweep::{SweepRef};
//!
//! let mut capture = Capture::open("pcap_fixtures/street_vlp16.pcap.gz")?;
//! let mut pipeline = Pipeline::new("roof", Config::default())?;
//! let mut memory = Memory::new(HeapBuffers::default());
//! let mut sweeps = 0;
//! while let Some(datagram) = capture.next_datagram()? {
//!     pipeline.push(&datagram.parse()?);
//!     while let Some(event) = pipeline.poll(&mut memory) {
//!         match event {
//!             Event::Sweep(bytes) => {
//!                 let sweep = SweepRef::open(bytes.as_ref())?;
//!                 println!("{} columns, {} segments", sweep.columns.len(), sweep.segments.len());
//!                 sweeps += 1;
//!             }
//!             Event::Fault(fault) => return Err(fault.into()),
//!             Event::Objects(_) | Event::Notice(_) => {}
//!         }
//!     }
//! }
//! assert!(sweeps >= 5);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Words
//!
//! | word | meaning |
//! |---|---|
//! | datagram | a UDP payload with arrival time and source |
//! | packet | a datagram accepted as a Velodyne data or position packet |
//! | block | the 100-byte unit of a data packet |
//! | channel | index of a record within a firing, as the packet orders it |
//! | beam | the physical laser with its calibration; its row is fixed by its elevation |
//! | firing | one pass of all beams; a VLP-16 stores two per block |
//! | shot | one beam's part of a firing, at a time of its own |
//! | row, column | range-image indices; row 0 = highest elevation, a column = a firing, after each row's shift |
//! | shift | number of columns between a pixel and its firing; it depends on the row, and is 0 unless beams differ in azimuth |
//! | azimuth, elevation | rotation angle, clockwise from above, 0 = sensor +y; vertical angle |
//! | range | metres along the beam; 0 = no return, asked through [`sweep::layout::is_return`] only |
//! | return | one echo: strongest, last; dual = both |
//! | reflectivity | calibrated byte |
//! | unit | one sensor with its serial number: each HDL-64E has beams of its own |
//! | sweep | the columns between two crossings of the cut azimuth |
//! | label | u32 per pixel: 0 none, 1 ground, 2.. segment |
//! | segment | connected non-ground pixels with one label |
//! | strip | 64 columns, segmented together |
//! | run | neighbouring pixels of a row, each joined to the next |
//! | piece, component | runs joined as they were taken; pieces that belong together |
//! | scan, truth | a cloud that people labelled, and the labels they gave |
//! | object | a segment, or a part of one, that is published while the head turns; in scores, points with one label of the truth |
//! | drop | a datagram discarded by the kernel or by us |
//! | loss | a packet missing by the sensor's clock |
//! | gap | columns missing in a sweep; of the segmenter: how far apart beside each other returns may be that are joined |
//! | consumer | a program that reads sweeps from shared memory |
//! | domain | the folder by which a daemon and its consumers find each other |
//! | loan | shared memory for one sweep, filled before a consumer sees it |
//! | pool | the shared memory of all sweeps of a sensor |
//! | recording | capture files that grow with the datagrams received |
//! | feed | the queue from one receiving thread to a recording |

#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod admission;
mod beams;
pub mod cli;
pub mod cure;
pub mod daemon;
pub mod doctor;
pub mod export;
pub mod files;
pub mod floor;
pub mod gps;
pub mod holder;
pub mod http;
pub mod input;
pub mod judge;
pub mod network;
pub mod publish;
pub mod recording;
pub mod sensor_settings;
pub mod strangers;
pub mod streams;
mod suggest;
pub mod text;
pub mod tool;
pub mod web_interface;

/// Version of this build, with the commit in a release build of a repository: `0.1.0 (6707b6746
/// 2026-11-24)`.
pub const VERSION: &str = env!("SWEEPD_VERSION");

pub use sweepd_client::{client, host};
pub use sweepd_core::{assemble, buffers, pipeline, segment, sensor, sweep, wire};
pub use sweepd_messages as messages;
