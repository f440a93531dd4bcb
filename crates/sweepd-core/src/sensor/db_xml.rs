//! Calibrations as Velodyne ships them: db.xml, a boost serialization in degrees and centimetres.
//!
//! ```text
//! boost_serialization > DB > distLSB_                                  centimetres of one unit of distance
//!                          > enabled_, minIntensity_, maxIntensity_    lists of 64, by laser
//!                          > points_ > item > px > id_, rotCorrection_, vertCorrection_, distCorrection_, …
//! ```
//!
//! There are always 64 entries. On a smaller sensor `enabled_` is 0 from entry 16 or 32 on; those
//! entries hold zeros or (VLP-16 and Puck Hi-Res of VeloView) repeat the first ones, and are
//! skipped here.

use roxmltree::{Document, Node, ParsingOptions};

use super::table::{Entry, FileFormat, Key, Laser, MeasureUnit, Table, at, quote};
use super::{Calibration, CalibrationError};

const FORMAT: FileFormat = FileFormat {
    names: [
        "id_",
        "rotCorrection_",
        "vertCorrection_",
        "distCorrection_",
        "distCorrectionX_",
        "distCorrectionY_",
        "vertOffsetCorrection_",
        "horizOffsetCorrection_",
        "focalDistance_",
        "focalSlope_",
        "minIntensity_",
        "maxIntensity_",
        // ROS alone has the switch.
        "",
    ],
    // Every program that writes these files writes these keys.
    required: &[
        Key::Rotation,
        Key::Elevation,
        Key::Distance,
        Key::VerticalOffset,
        Key::HorizontalOffset,
    ],
    angle: MeasureUnit {
        name: "degrees",
        factor: std::f64::consts::PI / 180.0,
        mistaken: None,
    },
    length: MeasureUnit {
        name: "centimetres",
        factor: 0.01,
        mistaken: None,
    },
    count: "count",
    distance_unit: "distLSB_",
};

/// Possible numbers of beams; the number of entries in use is rounded up to one of them.
const SIZES: [usize; 4] = [16, 32, 64, 128];

/// Most nodes of a file; real files have about 4000.
const MAX_NODES: u32 = 100_000;

/// Most attributes of a file, counted by their `=`; real files have about
/// 160. Those of a tag are compared with each other, and so tens of thousands take far too long.
const MAX_ATTRIBUTES: usize = 2000;

/// Reads the text of a file named `file` (for messages).
///
/// # Errors
/// [`CalibrationError::At`] with file, line and key.
pub fn parse(text: &str, file: &str) -> Result<Calibration, CalibrationError> {
    let text = text.trim_start_matches('\u{feff}');
    refuse_what_no_db_xml_has(text, file)?;
    let options = ParsingOptions {
        allow_dtd: true,
        nodes_limit: MAX_NODES,
        ..ParsingOptions::default()
    };
    let document =
        Document::parse_with_options(text, options).map_err(|error| xml_error(&error, file))?;
    let reader = Reader {
        file,
        lines: text.match_indices('\n').map(|(offset, _)| offset).collect(),
    };
    let root = document.root_element();
    let db = reader.child(root, "DB")?;
    let points = reader.child(db, "points_")?;
    let mut table = Table {
        file,
        format: &FORMAT,
        count: child(points, FORMAT.count).map(|node| reader.entry(node)),
        distance_unit: child(db, FORMAT.distance_unit).map(|node| reader.entry(node)),
        lasers: items(points)
            .map(|item| reader.laser(item))
            .collect::<Result<_, _>>()?,
        line: reader.line(points),
    };
    let channels = table.channels()?;
    for key in [Key::MinIntensity, Key::MaxIntensity] {
        let values = reader.list(db, FORMAT.name(key), channels.len())?;
        for (laser, &channel) in table.lasers.iter_mut().zip(&channels) {
            laser.entries[key as usize] = values.get(channel).cloned();
        }
    }
    let used = reader.used(db, channels.len())?;
    let mut channel = channels.iter();
    table
        .lasers
        .retain(|_| channel.next().is_some_and(|&channel| channel < used));
    table.count = None;
    table.calibration()
}

/// Refuses XML that would take the parser more time or memory than a file of this size should.
fn refuse_what_no_db_xml_has(text: &str, file: &str) -> Result<(), CalibrationError> {
    // The format has an empty document type, so that one must be allowed. Without `<!ENTITY`
    // nothing can expand to more text than the file has. Namespaces are refused because every
    // element keeps all that surround it.
    let words = [
        ("<!ENTITY", "declares an entity (<!ENTITY)"),
        ("xmlns", "declares a namespace (xmlns)"),
    ];
    for (word, what) in words {
        if let Some(offset) = text.find(word) {
            return Err(at(
                file,
                line_of(text, offset),
                format!("{what}, which no db.xml does"),
            ));
        }
    }
    if let Some((offset, _)) = text.match_indices('=').nth(MAX_ATTRIBUTES) {
        return Err(at(
            file,
            line_of(text, offset),
            format!("more than {MAX_ATTRIBUTES} attributes, which no db.xml has"),
        ));
    }
    Ok(())
}

/// The line of a byte of the text, counted from 1.
fn line_of(text: &str, offset: usize) -> usize {
    1 + text[..offset].matches('\n').count()
}

/// Finds values in the document, with their lines.
struct Reader<'a> {
    file: &'a str,
    /// Offsets of the line ends: counting lines from the top for every value would take quadratic
    /// time.
    lines: Vec<usize>,
}

impl<'a> Reader<'a> {
    fn line(&self, node: Node<'_, '_>) -> usize {
        1 + self.lines.partition_point(|&end| end < node.range().start)
    }

    /// A child that must be there.
    fn child<'d, 'i>(
        &self,
        parent: Node<'d, 'i>,
        name: &str,
    ) -> Result<Node<'d, 'i>, CalibrationError> {
        child(parent, name).ok_or_else(|| {
            let message = format!(
                "no <{name}> in <{}>: not a db.xml, or a damaged one",
                parent.tag_name().name()
            );
            at(self.file, self.line(parent), message)
        })
    }

    fn entry<'d>(&self, node: Node<'d, '_>) -> Entry<'d> {
        Entry {
            text: node.text().unwrap_or_default().into(),
            line: self.line(node),
        }
    }

    fn laser<'d>(&self, item: Node<'d, '_>) -> Result<Laser<'d>, CalibrationError> {
        let mut laser = Laser::new(self.line(item));
        for node in self.child(item, "px")?.children().filter(Node::is_element) {
            // Other keys occur (closeSlope_ of VeloView) and are ignored.
            let Some(index) = FORMAT
                .names
                .iter()
                .position(|name| *name == node.tag_name().name())
            else {
                continue;
            };
            let entry = self.entry(node);
            if let Some(first) = &laser.entries[index] {
                if first.text.trim() == entry.text.trim() {
                    laser.repeated = Some((entry.line, FORMAT.names[index]));
                    continue;
                }
                return Err(at(
                    self.file,
                    entry.line,
                    format!("{} is there twice in one laser", FORMAT.names[index]),
                ));
            }
            laser.entries[index] = Some(entry);
        }
        Ok(laser)
    }

    /// A list with one value a laser, or an empty one where the file has none.
    fn list<'d>(
        &self,
        db: Node<'d, '_>,
        name: &str,
        lasers: usize,
    ) -> Result<Vec<Entry<'d>>, CalibrationError> {
        let Some(node) = child(db, name) else {
            return Ok(Vec::new());
        };
        let values: Vec<Entry<'d>> = items(node).map(|item| self.entry(item)).collect();
        if values.len() == lasers {
            return Ok(values);
        }
        let message = format!(
            "{name} has {} values, expected {lasers}, one a laser",
            values.len()
        );
        Err(at(self.file, self.line(node), message))
    }

    /// Entries in use: all up to the last enabled one, rounded up, since a beam that is switched
    /// off is still a beam.
    fn used(&self, db: Node<'_, '_>, lasers: usize) -> Result<usize, CalibrationError> {
        let mut end = 0;
        let enabled = self.list(db, "enabled_", lasers)?;
        for (index, entry) in enabled.iter().enumerate() {
            match entry.text.trim() {
                "0" | "false" => {}
                "1" | "true" => end = index + 1,
                other => {
                    let message = format!("enabled_: expected 0 or 1, found {}", quote(other));
                    return Err(at(self.file, entry.line, message));
                }
            }
        }
        Ok(match end {
            0 => lasers,
            _ => SIZES
                .into_iter()
                .find(|&size| size >= end)
                .unwrap_or(lasers)
                .min(lasers),
        })
    }
}

fn child<'d, 'i>(parent: Node<'d, 'i>, name: &str) -> Option<Node<'d, 'i>> {
    parent.children().find(|node| node.has_tag_name(name))
}

fn items<'d, 'i: 'd>(list: Node<'d, 'i>) -> impl Iterator<Item = Node<'d, 'i>> {
    list.children().filter(|node| node.has_tag_name("item"))
}

/// The parser's own message, with the line in our form.
fn xml_error(error: &roxmltree::Error, file: &str) -> CalibrationError {
    let message = error.to_string();
    let message = message
        .rsplit_once(" at ")
        .map_or(message.as_str(), |(message, _)| message);
    at(file, error.pos().row as usize, message)
}
