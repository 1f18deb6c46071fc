//! Threads that wait for parts of a step. A pool with queues costs more than a step of a small batch takes:
//! it allocates, and sleeps and wakes its threads each time. Here a thread is handed one closure at a time,
//! and looks out for the next one a while before it sleeps.
#![allow(unsafe_code)]

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicPtr, Ordering};
use std::thread::{self, JoinHandle, Thread};

use crate::error::{Error, Result};

/// Number of polls before yielding the processor for a moment, and number of such yields before going to sleep.
/// Each takes some ten microseconds on an idle machine, longer than the time between two steps of a plain loop.
const LOOKS: u32 = 300;
const YIELDS: u32 = 50;

/// Threads beside the caller's.
pub struct WorkerPool(Vec<Worker>);

impl WorkerPool {
    /// # Errors
    /// [`Error::Config`] if the system gives no more threads.
    pub fn new(workers: usize) -> Result<WorkerPool> {
        Ok(WorkerPool((0..workers).map(|_| Worker::new()).collect::<Result<_>>()?))
    }

    /// `work` on every part: one part for each thread, the last for the caller, which also takes what is left
    /// over.
    pub fn each<P: Send>(&mut self, parts: impl Iterator<Item = P>, work: impl Fn(P) + Sync) {
        share(&mut self.0, parts, &work);
    }
}

fn share<P: Send>(workers: &mut [Worker], mut parts: impl Iterator<Item = P>, work: &(impl Fn(P) + Sync)) {
    let Some((worker, others)) = workers.split_first_mut() else { return parts.for_each(work) };
    if let Some(part) = parts.next() {
        worker.join(|| work(part), || share(others, parts, work));
    }
}

/// A closure on the stack of the thread that waits for it.
struct Job {
    call: unsafe fn(*mut ()),
    closure: *mut (),
    waiting: Thread,
}

/// The worker's next job: nothing while null, [`quit`] to end.
type JobSlot = Arc<AtomicPtr<Job>>;

fn quit() -> *mut Job {
    std::ptr::without_provenance_mut(1)
}

struct Worker {
    desk: JobSlot,
    thread: Option<JoinHandle<()>>,
}

type Outcome = Option<Box<dyn Any + Send>>;

impl Worker {
    fn new() -> Result<Worker> {
        let desk = JobSlot::default();
        let theirs = Arc::clone(&desk);
        let thread = thread::Builder::new().name("crazyflie".into()).spawn(move || attend(&theirs));
        Ok(Worker { desk, thread: Some(thread.map_err(|e| Error::Config(format!("a thread: {e}")))?) })
    }

    /// Runs `there` on the worker and `here` on this thread, and returns when both are done. A panic of
    /// either is passed on.
    fn join(&mut self, there: impl FnOnce() + Send, here: impl FnOnce()) {
        let mut task = (Some(there), Outcome::None);
        let mut job = Job {
            call: call_of(&task),
            closure: std::ptr::from_mut(&mut task).cast(),
            waiting: thread::current(),
        };
        self.desk.store(&raw mut job, Ordering::Release);
        if let Some(thread) = &self.thread {
            thread.thread().unpark();
        }
        let panicked = catch_unwind(AssertUnwindSafe(here)).err();
        // Nothing leaves this function before the worker is done: `task` and `job` live until then.
        wait(|| self.desk.load(Ordering::Acquire).is_null());
        if let Some(panic) = panicked.or(task.1) {
            resume_unwind(panic);
        }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.desk.store(quit(), Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            let _ = thread.join();
        }
    }
}

fn wait(done: impl Fn() -> bool) {
    for _ in 0..LOOKS {
        if done() {
            return;
        }
        std::hint::spin_loop();
    }
    for _ in 0..YIELDS {
        if done() {
            return;
        }
        thread::yield_now();
    }
    while !done() {
        thread::park();
    }
}

/// The worker's life.
fn attend(desk: &AtomicPtr<Job>) {
    loop {
        wait(|| !desk.load(Ordering::Acquire).is_null());
        let job = desk.load(Ordering::Acquire);
        if job == quit() {
            return;
        }
        // SAFETY: `join` put the job here and waits until the desk is empty, so that the job and its closure
        // live until the store below; the closure may be called on another thread (`Send`), and it is called
        // once, because the desk is emptied before the next look.
        let waiting = unsafe {
            ((*job).call)((*job).closure);
            (*job).waiting.clone()
        };
        desk.store(std::ptr::null_mut(), Ordering::Release);
        waiting.unpark();
    }
}

/// Returns the function that calls a task of this type; the argument only gives its type.
fn call_of<F: FnOnce() + Send>(_: &(Option<F>, Outcome)) -> unsafe fn(*mut ()) {
    /// # Safety
    /// `task` points to a task of this type that nobody else uses meanwhile.
    unsafe fn call<F: FnOnce()>(task: *mut ()) {
        // SAFETY: the caller's promise
        let (closure, panicked) = unsafe { &mut *task.cast::<(Option<F>, Outcome)>() };
        if let Some(closure) = closure.take() {
            *panicked = catch_unwind(AssertUnwindSafe(closure)).err();
        }
    }
    call::<F>
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_is_done_once_by_any_number_of_threads() {
        for workers in 0..4 {
            let mut team = WorkerPool::new(workers).unwrap();
            for parts in 0..6 {
                let mut done = vec![0; parts];
                for _ in 0..200 {
                    team.each(done.iter_mut(), |part| *part += 1);
                }
                assert_eq!(done, vec![200; parts], "{workers} workers");
            }
        }
    }

    #[test]
    fn a_panic_reaches_the_caller_and_the_team_goes_on() {
        let mut team = WorkerPool::new(2).unwrap();
        for bad in 0..3 {
            let result = catch_unwind(AssertUnwindSafe(|| team.each(0..3, |part| assert_ne!(part, bad))));
            assert!(result.is_err());
        }
        let sum = std::sync::atomic::AtomicUsize::new(0);
        team.each(0..3_usize, |part| {
            sum.fetch_add(part, Ordering::Relaxed);
        });
        assert_eq!(sum.into_inner(), 3);
    }
}
