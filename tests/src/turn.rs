//! Lock against a data race of the validation layer between devices of one process.
//!
//! Layer 1.3.239 (Debian 12) finds its instances and devices in a map without a lock
//! (KhronosGroup/Vulkan-ValidationLayers, issue 4391). To create or destroy an instance or a device with the layer
//! therefore races with every Vulkan call of another thread on such an instance, and crashes at times.
//!
//! - A test that opens or closes a device with validation by itself holds [`turn()`] for as long as the device lives.
//! - A [`Gpu::new`](crate::Gpu::new) shares the lock with the others. Its pool opens and closes devices in a turn.
//!
//! Turns and shares exclude each other, so a program may contain both kinds of tests. The program `alone` has most tests
//! of the first kind, because a turn holds up the tests of all other threads. Threads that a test starts use its
//! devices without a turn of their own. The test opens its devices before it starts them, and closes the devices when
//! they have ended. Devices without validation need no turn.

use std::marker::PhantomData;
use std::sync::{Condvar, Mutex, MutexGuard};
use std::thread::{self, ThreadId};

/// Exclusive right of a thread to use devices with validation.
///
/// A struct that owns such a device has it as its last field, so that it is dropped after the device.
#[must_use]
pub struct Turn(Here);

/// Right of a thread to use one pooled device, which others share.
#[must_use]
pub(crate) struct Share(Here);

/// Marker of a value that stays in its thread. Other threads may borrow it.
type Here = PhantomData<MutexGuard<'static, ()>>;

struct Lock {
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    /// Thread that has the turn, and how many times it took it.
    owner: Option<(ThreadId, u32)>,
    /// Threads with a share.
    sharers: Vec<ThreadId>,
    /// Number of threads that wait for the turn. Until they had it, nobody gets a share.
    waiting: u32,
}

static LOCK: Lock =
    Lock { state: Mutex::new(State { owner: None, sharers: Vec::new(), waiting: 0 }), changed: Condvar::new() };

impl Lock {
    /// Locks the state. A panic of another test leaves the state as it is, and valid.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// Waits while `held` says so.
    fn wait<'a>(&self, state: MutexGuard<'a, State>, held: impl Fn(&State) -> bool) -> MutexGuard<'a, State> {
        self.changed.wait_while(state, |state| held(state)).unwrap_or_else(|e| e.into_inner())
    }
}

impl State {
    fn owned_by(&self, thread: ThreadId) -> bool {
        self.owner.is_some_and(|(owner, _)| owner == thread)
    }
}

/// Waits until no other thread uses a device with validation.
///
/// Other threads then wait until the turn is dropped.
///
/// A thread that has the turn may take it again. Dropping the outermost [`Turn`] passes it on.
///
/// # Panics
/// If this thread uses a pooled device: it would wait for itself.
pub fn turn() -> Turn {
    let me = thread::current().id();
    let mut state = LOCK.state();
    if !state.owned_by(me) {
        if state.sharers.contains(&me) {
            drop(state);
            panic!("this test uses a pooled device; use Gpu::fresh() for each device of the test");
        }
        state.waiting += 1;
        state = LOCK.wait(state, |state| state.owner.is_some() || !state.sharers.is_empty());
        state.waiting -= 1;
    }
    state.owner.get_or_insert((me, 0)).1 += 1;
    Turn(PhantomData)
}

/// Waits until no other thread has the turn or waits for it.
///
/// Threads that want the turn then wait until the share is dropped.
///
/// # Panics
/// If this thread has a share: two such tests would wait for each other.
pub(crate) fn share() -> Share {
    let me = thread::current().id();
    let mut state = LOCK.state();
    if state.sharers.contains(&me) {
        drop(state);
        panic!("this test has a pooled device; use Gpu::fresh() for each device of a test that needs two");
    }
    if !state.owned_by(me) {
        state = LOCK.wait(state, |state| state.owner.is_some() || state.waiting > 0);
    }
    state.sharers.push(me);
    Share(PhantomData)
}

impl Drop for Turn {
    fn drop(&mut self) {
        let mut state = LOCK.state();
        if let Some((_, depth)) = &mut state.owner {
            *depth -= 1;
            if *depth == 0 {
                state.owner = None;
                LOCK.changed.notify_all();
            }
        }
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        let me = thread::current().id();
        let mut state = LOCK.state();
        if let Some(at) = state.sharers.iter().position(|thread| *thread == me) {
            state.sharers.swap_remove(at);
            LOCK.changed.notify_all();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{LOCK, share, turn};
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::SeqCst};
    use std::sync::mpsc::channel;
    use std::sync::{Mutex, MutexGuard};
    use std::thread::{scope, sleep};
    use std::time::Duration;

    /// Keeps the threads of other tests of this module away.
    fn alone() -> MutexGuard<'static, ()> {
        static ALONE: Mutex<()> = Mutex::new(());
        ALONE.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// Runs `second` in another thread while this one has `first`. It must wait until `first` is dropped.
    fn waits<A, B>(first: impl FnOnce() -> A, second: impl FnOnce() -> B + Send) {
        let ours = first();
        let (started, begins) = channel();
        let dropped = AtomicBool::new(false);
        scope(|scope| {
            scope.spawn(|| {
                started.send(()).unwrap();
                let _theirs = second();
                assert!(dropped.load(SeqCst), "two threads had the turn");
            });
            begins.recv().unwrap();
            sleep(Duration::from_millis(50));
            dropped.store(true, SeqCst);
            drop(ours);
        });
    }

    #[test]
    fn a_thread_takes_its_turn_again_and_keeps_others_from_it() {
        let _alone = alone();
        waits(
            || {
                let outer = turn();
                drop((turn(), turn()));
                outer
            },
            turn,
        );
        // The outermost turn counts, in whatever order they are dropped.
        waits(
            || {
                let (first, second) = (turn(), turn());
                drop(first);
                second
            },
            turn,
        );
    }

    #[test]
    fn turns_and_shares_exclude_each_other() {
        let _alone = alone();
        waits(turn, share);
        waits(share, turn);
        // A share within a turn keeps others from it, too.
        waits(
            || {
                let (turn, share) = (turn(), share());
                drop(turn);
                share
            },
            turn,
        );
    }

    /// Threads that always share would never let another have its turn.
    #[test]
    fn a_waiting_turn_comes_before_new_shares() {
        let _alone = alone();
        let first = share();
        let had = AtomicBool::new(false);
        scope(|scope| {
            scope.spawn(|| {
                let _turn = turn();
                had.store(true, SeqCst);
            });
            while LOCK.state().waiting == 0 {
                sleep(Duration::from_millis(1));
            }
            let second = scope.spawn(|| {
                let _share = share();
                assert!(had.load(SeqCst), "a share came before the turn");
            });
            sleep(Duration::from_millis(50));
            drop(first);
            second.join().unwrap();
        });
    }

    #[test]
    fn one_thread_at_a_time_has_the_turn() {
        let _alone = alone();
        let (inside, runs) = (AtomicU32::new(0), AtomicU32::new(0));
        scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    for _ in 0..500 {
                        let _turn = turn();
                        assert_eq!(inside.fetch_add(1, SeqCst), 0);
                        drop(turn());
                        runs.fetch_add(1, SeqCst);
                        assert_eq!(inside.fetch_sub(1, SeqCst), 1);
                    }
                });
            }
        });
        assert_eq!(runs.load(SeqCst), 2000);
    }

    #[test]
    fn a_panic_passes_the_turn_on() {
        let _alone = alone();
        for _ in 0..2 {
            let thread = std::thread::spawn(|| {
                let _turn = turn();
                panic!("planted");
            });
            assert!(thread.join().is_err());
        }
        drop(turn());
    }

    #[test]
    fn threads_that_would_wait_for_themselves_panic() {
        let _alone = alone();
        let _share = share();
        assert!(catch_unwind(AssertUnwindSafe(|| drop(turn()))).is_err());
        assert!(catch_unwind(AssertUnwindSafe(|| drop(share()))).is_err());
    }
}
