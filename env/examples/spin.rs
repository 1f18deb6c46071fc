use crazyflie_env::{config::Options, model::Model, observation::*, vector::*};
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let n: usize = a[1].parse().unwrap();
    let opt = Options::parse(&a[2]).unwrap();
    let mut env = VectorEnv::new(&Model::thesis(), &opt, n).unwrap();
    let mut obs = vec![0.0; n * OBSERVATION];
    let seeds: Vec<u64> = (0..n as u64).collect();
    env.reset(Some(&seeds), None, &mut obs).unwrap();
    let i = env.interface();
    let lift = if i.hover_lift > 0.0 { (2.0 * i.hover_lift / i.lift_max - 1.0) as f32 } else { 0.0 };
    let act: Vec<f32> = (0..n * ACTION).map(|i| if i % 4 == 3 { lift } else { 0.02 * ((i * 7919 % 199) as f32 / 99.0 - 1.0) }).collect();
    let (mut r, mut t, mut u) = (vec![0.0; n], vec![false; n], vec![false; n]);
    let steps = 200_000_000 / n / a.get(3).map_or(1, |x| x.parse().unwrap());
    for round in 0..3 {
        let cpu = || std::fs::read_to_string("/proc/self/schedstat").unwrap().split(' ').next().unwrap().parse::<f64>().unwrap() * 1e-9;
        let t0 = cpu();
        for _ in 0..steps {
            env.step(&act, Out { observations: &mut obs, rewards: &mut r, terminated: &mut t, truncated: &mut u }).unwrap();
        }
        println!("{round}: {:.1} M/s", (steps * n) as f64 / (cpu() - t0) / 1e6);
    }
}
