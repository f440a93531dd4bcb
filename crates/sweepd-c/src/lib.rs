//! The library libsweepd: `sweepd_client` behind a C ABI. `examples/sweepd.h` declares what is here, and says what
//! each function means to its callers.
//!
//! No panic leaves a function, and what C can be told of a mistake is an error: a NULL, an invalid name, a client from
//! before fork(). That a handle is one of this library's and was not given back is the caller's to keep.

#![warn(missing_docs)]

use std::cell::RefCell;
use std::ffi::{CStr, CString, OsStr, c_char, c_void};
use std::os::unix::ffi::OsStrExt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process;
use std::ptr;
use std::slice;
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

use sweepd_client::client::{
    Client, ClientError, Domain, Next, Objects, ObjectsMessage, Subscriber, Sweep,
};
use sweepd_client::sweep::{Header, LeastReturns, Obstacle, SweepRef, Zone};

mod abi;

const RECEIVED: i32 = 0;
const TIMEOUT: i32 = 1;
const UNPUBLISHED: i32 = 2;
const INTERRUPTED: i32 = 3;
const INVALID: i32 = 4;
const FAILED: i32 = 5;

/// Where there is no length.
const NO_LENGTH: usize = usize::MAX;

thread_local! {
    /// What failed last on this thread.
    static ERROR: RefCell<CString> = RefCell::default();
}

/// What a client follows.
pub enum Followed {
    /// A client of sweeps.
    Sweeps(Client),
    /// A client of objects.
    Objects(Objects),
}

/// What C holds of this library, which the process that made it may use. After fork() the child has a copy of it:
/// dropped there, it would free memory that the parent still uses.
pub struct Owned<T> {
    process: u32,
    what: T,
}

/// `sweepd_client`. The lock makes calls from several threads wait for each other.
pub type Handle = Owned<Mutex<Followed>>;

/// `sweepd_sample`. It keeps the memory that it is in, and so may outlive its client.
pub type Sample = Owned<Bytes>;

/// Where the bytes of a sample are. Several threads may read this, but not what it keeps.
pub struct Bytes {
    data: *const c_void,
    len: usize,
    _kept: Kept,
}

/// What keeps the memory of a sample.
#[allow(
    dead_code,
    clippy::large_enum_variant,
    reason = "only dropped, and in a box of its own"
)]
enum Kept {
    Sweep(Sweep),
    Objects(ObjectsMessage),
}

const fn is_send<T: Send>() {}
// Clients and samples may be used and dropped on any thread.
const _: () = (is_send::<Followed>(), is_send::<Kept>()).0;

impl<T> Owned<T> {
    fn give(what: T) -> *mut Self {
        let process = process::id();
        Box::into_raw(Box::new(Self { process, what }))
    }

    /// What C holds, unless it holds it since before fork().
    ///
    /// # Safety
    /// NULL, or what [`Owned::give`] gave and is not taken back meanwhile.
    unsafe fn get<'a>(this: *const Self, name: &str) -> Result<&'a T, String> {
        // SAFETY: as the caller promises.
        let this = unsafe { this.as_ref() }.ok_or_else(|| format!("the {name} is NULL"))?;
        match this.process == process::id() {
            true => Ok(&this.what),
            false => Err(format!(
                "this {name} was opened before fork(): open one in this process"
            )),
        }
    }

    /// Drops it; in a child the parent's is left alone.
    ///
    /// # Safety
    /// NULL, or what [`Owned::give`] gave and nobody uses any more.
    unsafe fn take_back(this: *mut Self) {
        // SAFETY: as the caller promises.
        if unsafe { this.as_ref() }.is_some_and(|this| this.process == process::id()) {
            // SAFETY: `give` made it of a box, and the caller gives it back.
            drop(unsafe { Box::from_raw(this) });
        }
    }
}

impl Bytes {
    fn of_sweep(sweep: Sweep) -> Self {
        let (data, len) = (sweep.bytes().as_ptr().cast(), sweep.bytes().len());
        let _kept = Kept::Sweep(sweep);
        Self { data, len, _kept }
    }

    fn of_objects(message: ObjectsMessage) -> Self {
        let (data, len) = (message.bytes().as_ptr().cast(), message.bytes().len());
        let _kept = Kept::Objects(message);
        Self { data, len, _kept }
    }
}

impl Followed {
    fn next(&mut self, timeout: Duration) -> Result<Next<Bytes>, ClientError> {
        Ok(match self {
            Self::Sweeps(client) => sample(client.next(timeout)?, Bytes::of_sweep),
            Self::Objects(objects) => sample(objects.next(timeout)?, Bytes::of_objects),
        })
    }

    fn subscriber(&self) -> &Subscriber {
        match self {
            Self::Sweeps(client) => client.as_ref(),
            Self::Objects(objects) => objects.as_ref(),
        }
    }
}

fn sample<T>(next: Next<T>, of: fn(T) -> Bytes) -> Next<Bytes> {
    match next {
        Next::Received(what) => Next::Received(of(what)),
        Next::Timeout => Next::Timeout,
        Next::Interrupted => Next::Interrupted,
    }
}

/// Notes what failed, for `sweepd_error`.
fn note(what: &str) {
    let text = CString::new(what.replace('\0', " ")).unwrap_or_default();
    // While the thread ends there is nobody to ask.
    let _ = ERROR.try_with(|error| error.replace(text));
}

/// Does what a function does; `failed` where that fails or panics, and the reason is noted.
fn caught<T>(failed: T, call: impl FnOnce() -> Result<T, String>) -> T {
    // What may be left half done is behind the client's lock, which the panic closes.
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(done)) => return done,
        Ok(Err(what)) => note(&what),
        Err(_) => {
            note("libsweepd panicked, which is a fault of its own: standard error has its message")
        }
    }
    failed
}

/// A client, once no other thread uses it.
///
/// # Safety
/// NULL, or a client that is not closed meanwhile.
unsafe fn lock<'a>(client: *const Handle) -> Result<MutexGuard<'a, Followed>, String> {
    // Of another process the lock may be held by a thread that is not in this one.
    // SAFETY: as the caller promises.
    let followed = unsafe { Owned::get(client, "client") }?.lock();
    followed.map_err(|_| {
        "an earlier call on this client panicked: close it, and open another".to_owned()
    })
}

/// The bytes of a text.
///
/// # Safety
/// NULL, or a text that ends in a zero and does not change meanwhile.
unsafe fn bytes<'a>(text: *const c_char) -> Option<&'a [u8]> {
    // SAFETY: as the caller promises.
    (!text.is_null()).then(|| unsafe { CStr::from_ptr(text) }.to_bytes())
}

/// The domain in a folder; the default one for NULL and an empty text.
///
/// # Safety
/// As [`bytes`].
unsafe fn domain(root: *const c_char) -> Domain {
    // SAFETY: as the caller promises.
    match unsafe { bytes(root) } {
        None | Some([]) => Domain::default(),
        Some(root) => Domain::at(OsStr::from_bytes(root)),
    }
}

/// Writes a text and a zero, as much as there is room for; gives the length of the whole.
///
/// # Safety
/// `to` is NULL or has room for `capacity` bytes.
unsafe fn put(text: &str, to: *mut c_char, capacity: usize) -> usize {
    if !to.is_null() && capacity > 0 {
        let len = text.len().min(capacity - 1);
        // SAFETY: the text has so many bytes, the room one more, and a text of this library's is not in it.
        unsafe {
            ptr::copy_nonoverlapping(text.as_ptr().cast(), to, len);
            to.add(len).write(0);
        }
    }
    text.len()
}

fn handle(followed: Followed) -> *mut Handle {
    Owned::give(Mutex::new(followed))
}

/// See `sweepd.h`.
#[unsafe(no_mangle)]
pub extern "C" fn sweepd_abi_version() -> u32 {
    abi::VERSION
}

/// See `sweepd.h`.
#[unsafe(no_mangle)]
pub extern "C" fn sweepd_error() -> *const c_char {
    let text = ERROR.try_with(|error| error.borrow().as_ptr());
    text.unwrap_or(c"".as_ptr())
}

/// See `sweepd.h`.
///
/// # Safety
/// Both are NULL or texts that end in a zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_client_open(
    sensor: *const c_char,
    root: *const c_char,
) -> *mut Handle {
    caught(ptr::null_mut(), || {
        // SAFETY: as the caller promises.
        let (sensor, domain) = unsafe { (bytes(sensor), domain(root)) };
        let sensor = sensor.ok_or("the name of the sensor is NULL")?;
        let sensor = str::from_utf8(sensor).map_err(|_| "the name of the sensor is not UTF-8")?;
        let client = Client::within(&domain, sensor).map_err(|error| error.to_string())?;
        Ok(handle(Followed::Sweeps(client)))
    })
}

/// See `sweepd.h`.
///
/// # Safety
/// NULL, or a client that is not closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_client_objects(client: *mut Handle) -> *mut Handle {
    caught(ptr::null_mut(), || {
        // SAFETY: as the caller promises.
        let followed = unsafe { lock(client) }?;
        let Followed::Sweeps(client) = &*followed else {
            return Err(
                "this client has objects already: ask one of sweeps for another".to_owned(),
            );
        };
        let objects = client.objects().map_err(|error| error.to_string())?;
        Ok(handle(Followed::Objects(objects)))
    })
}

/// See `sweepd.h`.
///
/// # Safety
/// `client` is NULL or not closed; `to` is NULL or has room for a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_client_next(
    client: *mut Handle,
    timeout_ns: i64,
    to: *mut *mut Sample,
) -> i32 {
    caught(FAILED, || {
        if to.is_null() {
            return Err("there is no place for the sample: it is NULL".to_owned());
        }
        // SAFETY: as the caller promises.
        let mut followed = unsafe {
            to.write(ptr::null_mut());
            lock(client)?
        };
        let timeout = u64::try_from(timeout_ns).map_or(Duration::MAX, Duration::from_nanos);
        match followed.next(timeout) {
            Ok(Next::Received(sample)) => {
                // SAFETY: as above.
                unsafe { to.write(Owned::give(sample)) };
                Ok(RECEIVED)
            }
            Ok(Next::Timeout) if followed.subscriber().is_published() => Ok(TIMEOUT),
            Ok(Next::Timeout) => Ok(UNPUBLISHED),
            Ok(Next::Interrupted) => Ok(INTERRUPTED),
            Err(error @ (ClientError::Layout { .. } | ClientError::Objects { .. })) => {
                note(&error.to_string());
                Ok(INVALID)
            }
            Err(error) => Err(error.to_string()),
        }
    })
}

/// See `sweepd.h`.
///
/// # Safety
/// NULL, or a client that is not closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_client_has_next(client: *mut Handle) -> i32 {
    caught(0, || {
        // SAFETY: as the caller promises.
        Ok(unsafe { lock(client) }?.subscriber().has_next().into())
    })
}

/// See `sweepd.h`.
///
/// # Safety
/// NULL, or a client that is not closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_client_missed(client: *mut Handle) -> u64 {
    // SAFETY: as the caller promises.
    caught(0, || match &*unsafe { lock(client) }? {
        Followed::Sweeps(client) => Ok(client.missed()),
        Followed::Objects(_) => Ok(0),
    })
}

/// See `sweepd.h`.
///
/// # Safety
/// NULL, or a client that is not closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_client_reopened(client: *mut Handle) -> u64 {
    // SAFETY: as the caller promises.
    caught(0, || Ok(unsafe { lock(client) }?.subscriber().reopened()))
}

/// See `sweepd.h`.
///
/// # Safety
/// NULL, or a client that is not closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_client_is_connected(client: *mut Handle) -> i32 {
    caught(0, || {
        // SAFETY: as the caller promises.
        Ok(unsafe { lock(client) }?.subscriber().is_connected().into())
    })
}

/// See `sweepd.h`.
///
/// # Safety
/// NULL, or a client that is not closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_client_is_published(client: *mut Handle) -> i32 {
    caught(0, || {
        // SAFETY: as the caller promises.
        Ok(unsafe { lock(client) }?.subscriber().is_published().into())
    })
}

/// See `sweepd.h`.
///
/// # Safety
/// `client` is NULL or not closed, `key` NULL or a text that ends in a zero, `text` NULL or has room for
/// `capacity` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_client_attribute(
    client: *mut Handle,
    key: *const c_char,
    text: *mut c_char,
    capacity: usize,
) -> usize {
    caught(NO_LENGTH, || {
        // SAFETY: as the caller promises.
        let (followed, key) = unsafe { (lock(client)?, bytes(key)) };
        let key = String::from_utf8_lossy(key.unwrap_or_default());
        let found = followed.subscriber().attribute(&key);
        // SAFETY: as the caller promises. That there is none is no failure.
        Ok(found.map_or(NO_LENGTH, |found| unsafe { put(&found, text, capacity) }))
    })
}

/// See `sweepd.h`.
///
/// # Safety
/// `root` is NULL or a text that ends in a zero, `names` NULL or has room for `capacity` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_sensors(
    root: *const c_char,
    names: *mut c_char,
    capacity: usize,
) -> usize {
    caught(NO_LENGTH, || {
        // SAFETY: as the caller promises.
        let domain = unsafe { domain(root) };
        let found = Client::sensors(&domain).map_err(|error| error.to_string())?;
        // SAFETY: as the caller promises.
        Ok(unsafe { put(&found.join("\n"), names, capacity) })
    })
}

/// See `sweepd.h`.
///
/// # Safety
/// NULL, or a client that no thread uses any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_client_close(client: *mut Handle) {
    caught((), || {
        // SAFETY: as the caller promises.
        unsafe { Owned::take_back(client) };
        Ok(())
    });
}

/// See `sweepd.h`.
///
/// # Safety
/// `sample` is NULL or not released; `len` is NULL or has room for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_sample_bytes(
    sample: *const Sample,
    len: *mut usize,
) -> *const c_void {
    caught(ptr::null(), || {
        // SAFETY: as the caller promises.
        let bytes = unsafe { Owned::get(sample, "sample") };
        if !len.is_null() {
            // SAFETY: as the caller promises.
            unsafe { len.write(bytes.as_ref().map_or(0, |bytes| bytes.len)) };
        }
        Ok(bytes?.data)
    })
}

/// See `sweepd.h`.
///
/// # Safety
/// NULL, or a sample that was not released.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_sample_release(sample: *mut Sample) {
    caught((), || {
        // SAFETY: as the caller promises.
        unsafe { Owned::take_back(sample) };
        Ok(())
    });
}

/// Returns the nearest obstacle in a zone of a sweep.
///
/// # Safety
/// `bytes` is NULL or has `len` bytes, `zone` is NULL or a zone, and so is `least`.
unsafe fn obstacle(
    bytes: *const c_void,
    len: usize,
    zone: *const [[f64; 3]; 2],
    least: *const LeastReturns,
) -> Result<Option<Obstacle>, String> {
    // SAFETY: as the caller promises.
    let (zone, least) = unsafe { (zone.as_ref(), least.as_ref()) };
    let [least_m, most_m] = zone.ok_or("the zone is NULL")?;
    let zone = Zone::new(*least_m, *most_m).map_err(|error| error.to_string())?;
    if bytes.is_null() {
        return Err("the bytes of the sweep are NULL".to_owned());
    }
    // SAFETY: as the caller promises. If a publisher writes to them, it is the copy of the header that counts.
    let bytes = unsafe { slice::from_raw_parts(bytes.cast(), len) };
    let header = Header::copied(bytes).map_err(|error| error.to_string())?;
    let sweep = SweepRef::with_header(&header, bytes).map_err(|error| error.to_string())?;
    Ok(sweep.obstacle(&zone, least.copied().unwrap_or_default()))
}

/// See `sweepd.h`.
///
/// # Safety
/// `bytes` is NULL or has `len` bytes, `zone` is NULL or a zone, so is `least`, and `to` is NULL or has room for an
/// obstacle.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sweepd_find_obstacle(
    bytes: *const c_void,
    len: usize,
    zone: *const [[f64; 3]; 2],
    least: *const LeastReturns,
    to: *mut Obstacle,
) -> i32 {
    caught(-1, || {
        // SAFETY: as the caller promises.
        let found = unsafe { obstacle(bytes, len, zone, least) }?;
        if let (Some(found), false) = (found, to.is_null()) {
            // SAFETY: as the caller promises.
            unsafe { to.write(found) };
        }
        Ok(found.is_some().into())
    })
}
