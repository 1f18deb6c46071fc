use super::*;

fn nodes(code: impl FnOnce() -> Symbol) -> (Node, usize) {
    let (id, graph) = record(|| Ok(code().id())).unwrap();
    (graph.nodes()[id as usize], graph.nodes().len())
}

#[test]
fn what_is_the_same_is_written_down_once() {
    let (_, count) = nodes(|| {
        let (x, y) = (Symbol::input(0), Symbol::input(1));
        (x + y) * (x + y)
    });
    assert_eq!(count, 4);
}

#[test]
fn constants_are_computed_at_once() {
    let two = |node| assert_eq!(node, Node::Number(2.0_f64.to_bits()));
    two(nodes(|| Symbol::from_f64(16.0).sqrt() * Symbol::from_f64(0.5)).0);
    two(nodes(|| Symbol::from_f64(2.0) + Symbol::zero() * Symbol::input(0)).0);
    two(nodes(|| Symbol::select(!Symbol::nothing(), Symbol::from_f64(2.0), Symbol::input(0))).0);
    assert_eq!(
        nodes(|| Symbol::input(0) * Symbol::from_f64(1.0) - Symbol::zero()).0,
        Node::Input(Kind::Number, 0)
    );
}

#[test]
fn work_that_may_be_needed_is_recorded() {
    let ((may, never, always), _) = record(|| {
        let unknown = Symbol::input(0).lt(Symbol::zero());
        let (never, always) = (Symbol::nothing() & unknown, !Symbol::nothing() | unknown);
        Ok((
            [Symbol::any(unknown), Symbol::all(unknown)],
            [Symbol::any(never), Symbol::all(never)],
            [Symbol::any(always), Symbol::all(always)],
        ))
    })
    .unwrap();
    assert_eq!((may, never, always), ([true, false], [false, false], [true, true]));
}

#[test]
fn a_number_that_is_looked_up_too_early_is_a_fault() {
    let error = record(|| Ok(Symbol::input(0).lane(0))).unwrap_err().to_string();
    assert!(error.contains("not known before the flight"), "{error}");
    assert_eq!(record(|| Ok(Symbol::from_f64(3.5).lane(0))).unwrap().0, 3.5);
}

#[test]
fn elementary_functions_have_bodies_of_plain_operations() {
    for call in [Call::Sin, Call::Cos, Call::SinQuarter, Call::CosQuarter, Call::Exp, Call::Ln] {
        let (id, graph) = elementary_body(call).unwrap();
        assert!(id > 5 && graph.nodes().iter().all(|node| !matches!(node, Node::Call(..))), "{call:?}");
    }
}
