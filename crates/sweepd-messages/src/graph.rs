//! `rmw_dds_common/ParticipantEntitiesInfo`, on the topic `ros_discovery_info`: which endpoints of a
//! participant belong to which node.

use crate::cdr::Writer;

/// Identifier of a participant or an endpoint: the 16 bytes of its GUID.
pub type Gid = [u8; 16];

/// A node of ROS.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Node {
    /// Its namespace, from `/` on.
    pub namespace: String,
    /// Its name.
    pub name: String,
    /// Its readers.
    pub readers: Vec<Gid>,
    /// Its writers.
    pub writers: Vec<Gid>,
}

/// How many bytes an identifier takes. What gets the wrong form may fail badly: send each reader
/// that of its own release.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GidForm {
    /// 16: Iron and later.
    Bytes16,
    /// 24, zeros at the end: before Iron.
    Bytes24,
}

impl GidForm {
    fn write(self, gid: &Gid, writer: &mut Writer<'_>) {
        writer.raw(gid);
        if self == Self::Bytes24 {
            writer.raw(&[0; 8]);
        }
    }
}

/// Appends the message.
pub fn encode(participant: &Gid, nodes: &[Node], form: GidForm, message: &mut Vec<u8>) {
    let mut writer = Writer::new(message);
    form.write(participant, &mut writer);
    writer.count(nodes.len());
    for node in nodes {
        writer.text(&node.namespace);
        writer.text(&node.name);
        for gids in [&node.readers, &node.writers] {
            writer.count(gids.len());
            for gid in gids {
                form.write(gid, &mut writer);
            }
        }
    }
}
