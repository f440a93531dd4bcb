//! What the limits of this process leave it: descriptors, addresses, and the memory of its cgroup.
//! Without a look at them, iceoryx2 names its own step that failed, and the kernel ends a process
//! whose cgroup is full without a word.

use std::fs;
use std::path::Path;

use crate::host;

/// Descriptors that a service takes, with some to spare: 13 where it has a pool.
const OF_A_SERVICE: u64 = 16;
/// Those that a sensor takes with its two services, its port and its first consumers.
const OF_A_SENSOR: u64 = 40;
const MIB: u64 = 1 << 20;

/// A limit that leaves too little.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Shortage {
    /// Of open files.
    #[error(
        "this process may open {limit} files and {open} are open, and each sensor takes {OF_A_SENSOR}: raise the limit \
         (ulimit -n, LimitNOFILE= in a unit)"
    )]
    Descriptors {
        /// How many there may be.
        limit: u64,
        /// How many there are.
        open: u64,
    },
    /// Of addresses, bytes.
    #[error(
        "this process may have {} MiB of addresses, it has {} MiB, and shared memory takes {} MiB more: raise the limit \
         (ulimit -v, LimitAS= in a unit), or allow fewer consumers (max_consumers)",
        limit / MIB, used.div_ceil(MIB), wanted.div_ceil(MIB)
    )]
    Addresses {
        /// How many there may be.
        limit: u64,
        /// How many there are.
        used: u64,
        /// How many more are needed.
        wanted: u64,
    },
    /// Of the memory of a cgroup, bytes.
    #[error(
        "the cgroup {group} may have {} MiB of memory, it has {} MiB, and shared memory takes {} MiB more: raise the limit \
         (MemoryMax= in a unit, --memory of a container), or allow fewer consumers (max_consumers)",
        limit / MIB, used.div_ceil(MIB), wanted.div_ceil(MIB)
    )]
    Memory {
        /// Its path, below the root of cgroups.
        group: String,
        /// How many there may be.
        limit: u64,
        /// How many are in use, without what the kernel can take back.
        used: u64,
        /// How many more are needed.
        wanted: u64,
    },
}

/// Checks that this process may have a service more, with this many bytes of shared memory.
///
/// # Errors
/// [`Shortage`].
pub fn require(wanted: u64) -> Result<(), Shortage> {
    let limit = host::limit(libc::RLIMIT_NOFILE);
    // Where that takes one too many, all are open.
    let open = fs::read_dir("/proc/self/fd").map_or(limit, |open| open.count() as u64);
    if open.saturating_add(OF_A_SERVICE) > limit {
        return Err(Shortage::Descriptors { limit, open });
    }
    let limit = host::limit(libc::RLIMIT_AS);
    let used = own_addresses();
    if used.saturating_add(wanted) > limit {
        return Err(Shortage::Addresses {
            limit,
            used,
            wanted,
        });
    }
    let own = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    require_memory(Path::new("/sys/fs/cgroup"), &own, wanted)
}

/// Bytes of addresses that this process has.
fn own_addresses() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    number_of(&status, "VmSize:") * 1024
}

/// The number behind a name, in lines of both; 0 where there is none.
fn number_of(lines: &str, name: &str) -> u64 {
    let mut fields = lines.lines().map(str::split_whitespace);
    let found =
        fields.find_map(|mut line| line.next().filter(|&first| first == name).and(line.next()));
    found.and_then(|number| number.parse().ok()).unwrap_or(0)
}

/// How a version of cgroups names its files.
struct Files {
    limit: &'static str,
    used: &'static str,
    /// What the kernel can take back, in memory.stat.
    caches: [&'static str; 2],
}

const V1: Files = Files {
    limit: "memory.limit_in_bytes",
    used: "memory.usage_in_bytes",
    caches: ["total_inactive_file", "total_active_file"],
};
const V2: Files = Files {
    limit: "memory.max",
    used: "memory.current",
    caches: ["inactive_file", "active_file"],
};

/// Checks the cgroup of this process, which the lines of /proc/self/cgroup name, and those above it
/// (cgroups(7)). In a container, a path may be the host's, and only its root is there.
fn require_memory(root: &Path, own: &str, wanted: u64) -> Result<(), Shortage> {
    for line in own.lines() {
        let mut fields = line.splitn(3, ':').skip(1);
        let (Some(controllers), Some(path)) = (fields.next(), fields.next()) else {
            continue;
        };
        let (root, files) = match controllers {
            "" => (root.to_owned(), V2),
            _ if controllers.split(',').any(|one| one == "memory") => (root.join("memory"), V1),
            _ => continue,
        };
        for group in Path::new(path).ancestors() {
            let folder = root.join(group.strip_prefix("/").unwrap_or(group));
            let read = |name| fs::read_to_string(folder.join(name)).unwrap_or_default();
            // `max` is none.
            let Ok(limit) = read(files.limit).trim().parse() else {
                continue;
            };
            let used: u64 = read(files.used).trim().parse().unwrap_or(0);
            if used.saturating_add(wanted) <= limit {
                continue;
            }
            // The kernel adds these up when they are read, which may take it a while.
            let stat = read("memory.stat");
            let caches = files.caches.map(|name| number_of(&stat, name));
            let used = used.saturating_sub(caches.iter().sum());
            if used.saturating_add(wanted) > limit {
                let group = group.display().to_string();
                return Err(Shortage::Memory {
                    group,
                    limit,
                    used,
                    wanted,
                });
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A group of 100 MiB with 30 in use, of which 10 are caches, below one of 200 MiB with 150.
    fn groups(root: &Path, files: &Files) {
        let [inactive, active] = files.caches;
        for (folder, limit, used) in [("robot/sweepd", 100, 30), ("robot", 200, 150)] {
            let folder = root.join(folder);
            fs::create_dir_all(&folder).unwrap();
            fs::write(folder.join(files.limit), format!("{}\n", limit * MIB)).unwrap();
            fs::write(folder.join(files.used), format!("{}\n", used * MIB)).unwrap();
            let stat = format!("anon 5\n{inactive} {}\n{active} {}\n", 4 * MIB, 6 * MIB);
            fs::write(folder.join("memory.stat"), stat).unwrap();
        }
        fs::write(root.join(files.limit), "max\n").unwrap();
    }

    #[test]
    fn the_narrowest_of_a_cgroup_and_those_above_it_is_named() {
        let root = std::env::temp_dir().join(format!("sweepd-cgroup-{}", std::process::id()));
        groups(&root, &V2);
        groups(&root.join("memory"), &V1);
        for own in [
            "0::/robot/sweepd\n",
            "3:cpu:/\n4:hugetlb,memory:/robot/sweepd\n0::/\n",
        ] {
            let check = |mib: u64| require_memory(&root, own, mib * MIB);
            check(60).unwrap();
            let error = check(70).unwrap_err().to_string();
            let says = "the cgroup /robot may have 200 MiB of memory, it has 140 MiB, and shared memory takes 70 MiB more";
            assert!(error.starts_with(says), "{error}");
            let error = check(81).unwrap_err().to_string();
            let says = "the cgroup /robot/sweepd may have 100 MiB of memory, it has 20 MiB";
            assert!(error.starts_with(says), "{error}");
        }
        // As in a container, which does not see the path of the host.
        require_memory(&root, "0::/docker/1234\n", 1 << 40).unwrap();
        fs::remove_dir_all(root).unwrap();
    }
}
